"""Values of an LFT on lines through a generic point, and McMillan degrees from them.

On the line of a delta that delta runs over a circle of the complex plane, the others stay at the
generic point. The degree is the rank of a Loewner matrix (`mbdlft.bound.degree` also proves it; here it
is only a guide, so a plain threshold does).
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.lft.lft import LFT

_CENTER, _RADIUS = 0.6, 0.8  # of the range: where the generic point is, and the circle around it
_MORE_POINTS = 3  # on a circle than the degree needs
_RANK = 1e-9  # of the largest singular value
_ZERO = 1e-12  # of the size of its terms: an entry below is zero
_NOISE = 1e-11  # of the largest entry beside it: a row or column below is zero
_BOX_POINTS = 24


class Lines(NamedTuple):
    """The generic point, a circle of distances from it for each delta, and points of the box.

    The first point of the box is delta = 0. `diagonal` is a circle for a line on which all deltas move.
    """

    center: Mapping[str, float]
    circles: Mapping[str, NDArray[Any]]
    diagonal: NDArray[Any]
    slopes: Mapping[str, float]
    box: Mapping[str, Array]


class Values(NamedTuple):
    """Values (points, rows, columns) on each circle, on the diagonal, and on the box."""

    circles: dict[str, NDArray[Any]]
    diagonal: NDArray[Any]
    box: Array


def lines_of(degrees: Mapping[str, int], seed: int, shift: Array | float = 0.0) -> Lines:
    """Lines for LFTs of about these degrees, in the distances of the deltas from a point.

    `shift` is the point (number of deltas); the box is the range of the deltas.
    """
    random = np.random.default_rng(seed)

    def circle(degree: int) -> NDArray[Any]:
        count = 2 * (degree + _MORE_POINTS)
        angles = 2.0 * np.pi * (np.arange(count) + random.uniform()) / count
        return np.asarray(_RADIUS * np.exp(1j * angles))

    inside = random.uniform(-1.0, 1.0, (_BOX_POINTS, len(degrees)))
    near_corners = 0.95 * np.sign(inside) + 0.05 * inside
    box = np.vstack([np.zeros((1, len(degrees))), np.vstack([inside, near_corners]) - shift])
    return Lines(
        {name: float(random.uniform(-_CENTER, _CENTER)) for name in degrees},
        {name: circle(degree) for name, degree in degrees.items()},
        circle(min(24, sum(degrees.values()))),
        {name: float(random.uniform(0.5, 1.0)) for name in degrees},
        {name: box[:, k] for k, name in enumerate(degrees)},
    )


def values_on(a: LFT, lines: Lines, *, diagonal: bool = False) -> Values:
    """Values on the lines of the deltas that `a` has; on the diagonal only if asked for."""
    n = a.order
    center, slopes = (
        np.repeat([field[b.name] for b in a.blocks], [b.size for b in a.blocks])
        for field in (lines.center, lines.slopes)
    )
    # the same in distances from the center: then the others are fixed by leaving their channels out
    solved = np.linalg.solve(np.eye(n) - a.M11 * center, np.hstack([a.M11, a.M12]))
    A, B = solved[:, :n], solved[:, n:]
    C = a.M21 + (a.M21 * center) @ A
    D = a.M22 + (a.M21 * center) @ B
    circles = {}
    for name, part in a.slices().items():
        size = part.stop - part.start
        deltas = np.repeat(lines.circles[name][:, None], size, axis=1)
        circles[name] = _values(A[part, part], B[part], C[:, part], D, deltas)
    on_box = [np.repeat(lines.box[b.name][:, None], b.size, axis=1) for b in a.blocks]
    count = 1 + 2 * _BOX_POINTS
    box = _values(a.M11, a.M12, a.M21, a.M22, np.hstack([np.zeros((count, 0)), *on_box]))
    along = lines.diagonal[:, None] * slopes if diagonal else np.zeros((0, n), dtype=complex)
    return _without_noise(Values(circles, _values(A, B, C, D, along), box))


def channels_at(M11: Array, M12: Array, deltas: NDArray[Any]) -> NDArray[Any]:
    """z = (I - M11 Delta)^-1 M12 (points, channels, inputs) at deltas (points, channels)."""
    loops = np.eye(len(M11)) - M11 * deltas[:, None, :]
    right = np.broadcast_to(M12, (len(deltas), *M12.shape)).astype(deltas.dtype)
    return np.asarray(np.linalg.solve(loops, right))


def pole_distance(loop: Array, largest: float) -> float:
    """Of the nearest pole of one delta from zero, when the others are zero; `largest` at most."""
    try:
        size = np.max(np.abs(np.linalg.eigvals(loop)), initial=0.0)
    except np.linalg.LinAlgError:  # the iteration has no end: no eigenvalue is above the norm
        size = np.linalg.norm(loop)
    return float(1.0 / max(1.0 / largest, size))


def degree(values: NDArray[Any], circle: NDArray[Any]) -> int:
    """McMillan degree of values (points, rows, columns) on a circle, as far as its points can tell."""
    count = len(circle) // 2
    if not np.all(np.isfinite(values)):
        return count
    rows, columns = equilibrate(values)
    scaled = values * rows[:, None] * columns
    left, right = directions(0, len(rows), count).T, directions(1, len(columns), count)
    one = ((left[:, None, :] @ scaled[::2])[:, 0]) @ right
    other = np.einsum("ap,pqb,qb->ab", left, scaled[1::2].transpose(1, 2, 0), right, optimize=True)
    return rank((one - other) / (circle[::2, None] - circle[1::2]))


def total_degree(values: Values, lines: Lines) -> int:
    """Sum of the degrees in all deltas: what is left to be repeated, at least."""
    return sum(degree(found, lines.circles[name]) for name, found in values.circles.items())


def equilibrate(values: NDArray[Any]) -> tuple[Array, Array]:
    """Factors of rows and columns that bring the largest entries to one."""
    size = np.max(np.abs(values), axis=0, initial=0.0)
    rows = 1.0 / or_one(np.max(size, axis=1, initial=0.0))
    return rows, 1.0 / or_one(np.max(size * rows[:, None], axis=0, initial=0.0))


def rank(matrix: NDArray[Any]) -> int:
    """Rank of a matrix whose rows and columns may have any size."""
    if not matrix.size or not np.all(np.isfinite(matrix)):
        return int(min(matrix.shape))
    rows, columns = equilibrate(matrix[None])
    singular = np.linalg.svd(matrix * rows[:, None] * columns, compute_uv=False)
    return int(np.sum(singular > _RANK * singular[0]))


@lru_cache(maxsize=512)
def directions(side: int, rows: int, count: int) -> Array:
    """Generic directions (rows, count), the same at every call."""
    return np.random.default_rng([side, rows, count]).standard_normal((rows, count))


def _without_noise(values: Values) -> Values:
    """Rows and columns that are nothing but rounding, beside all others, made zero."""
    size = np.max(np.abs(np.concatenate([values.box, *values.circles.values()])), axis=0)
    rows, columns = (
        or_one(np.max(size, axis=1, initial=0.0)),
        or_one(np.max(size, axis=0, initial=0.0)),
    )
    kept = np.outer(
        np.max(size / columns, axis=1, initial=0.0) > _NOISE,
        np.max(size / rows[:, None], axis=0, initial=0.0) > _NOISE,
    )
    return Values(
        {name: item * kept for name, item in values.circles.items()},
        values.diagonal * kept,
        values.box * kept,
    )


def _values(A: Array, B: Array, C: Array, D: Array, deltas: NDArray[Any]) -> NDArray[Any]:
    """D + C Delta (I - A Delta)^-1 B at deltas (points, channels); what cancels is zero."""
    if not len(deltas):
        return np.zeros((0, *D.shape), dtype=deltas.dtype)
    z = channels_at(A, B, deltas)
    values = D + C @ (deltas[:, :, None] * z)
    size = np.abs(D) + np.abs(C) @ np.max(np.abs(deltas[:, :, None] * z), axis=0, initial=0.0)
    return np.where(np.max(np.abs(values), axis=0) <= _ZERO * size, 0.0, values)


def or_one(size: Array) -> Array:
    """Sizes to divide by: 1 for zero."""
    return np.where(size > 0.0, size, 1.0)
