"""A proof that I - M11 Delta is invertible on the whole box |delta_k| <= 1, or a point where it is not.

Channels depend on each other in loops; the determinant is the product of those of the strongly connected
parts of the graph of M11, so each part is looked at by itself, in the deltas that it has. On a part of
the box, delta = c + h e with |e_k| <= 1, and with any matrix R, near the inverse at c,

    I - R (I - M11 Delta) = (I - R + R M11 c) + R M11 h e

is no larger than P = |I - R + R M11 c| + |R M11| h in each entry. A vector x > 0 with P x < x shows that
the spectral radius of P is below 1 (Collatz, Wielandt), and then R (I - M11 Delta) has an inverse. See
Neumaier, Interval Methods for Systems of Equations, 1990, chapter 4. To P is added what rounding makes,
and what a change of each entry of M11 by 2^-33 of itself makes: the proof holds for the model before it
was rounded, too, as for all models that near. Where the first look at the whole box is not enough, the
channels of each delta get other coordinates, which change no determinant, and then boxes are halved.

Where halving does not end, a zero of the determinant is looked for by steps down its slope. Its value is
1 at delta = 0, so it has a zero between there and a point where it is negative.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, WellPosednessError
from mbdlft.base.parameter import Parameter, at_values, to_physical
from mbdlft.base.running import after, budget, tell
from mbdlft.lft.lft import LFT
from mbdlft.lft.sparse import SparseLFT

PROVED, SAMPLED = "proved", "sampled"  # what a certificate says
PROVE = 1.0  # units of work of a proof, each at most about a second of one core
_UNIT = 2.0e9  # operations in a unit of work
_NEAR = 2.0**-33  # of an entry of M11: the model is regular also with entries changed by so much
_SMALLEST = 2.0**-13  # half width of a box that is not halved again [1]
_CHUNK = 64  # boxes that are looked at together
_ITERATIONS = 6  # of a vector of Perron: only where to cut depends on it
_STARTS, _STEPS = 16, 40  # of searches for a zero of the determinant
_BISECTIONS = 60
_BALANCE, _LIFT, _TINY = 10, 1e-4, 1e-290  # rounds of a balance, and what is added in each
_MOST_BOXES = 256  # that are kept in an answer; more are joined to one that holds them


class Box(NamedTuple):
    """Deltas c - h to c + h, both (number of blocks,) [1]."""

    center: Array
    half: Array


@dataclass(frozen=True, slots=True, eq=False)
class Regularity:
    """What is known of det(I - M11 Delta) on the box."""

    open_boxes: tuple[Box, ...]  # where it was not shown that it does not vanish
    zero: Array | None = None  # (number of blocks,): a point where it vanishes, up to rounding

    @property
    def is_proved(self) -> bool:
        """Whether the determinant is proved not to vanish on the box."""
        return self.zero is None and not self.open_boxes


def check_work(prove: float) -> None:
    """Raise an AnalysisError unless this is an amount of work."""
    if isinstance(prove, bool) or not isinstance(prove, int | float) or not 0.0 <= prove < np.inf:
        raise AnalysisError(f"prove: expected units of work, such as 10, got {prove!r}.")


def regularity(a: LFT, prove: float = PROVE) -> Regularity:
    """What is known of the determinant of I - M11 Delta of a plain LFT, after so many units of work.

    Nothing is known of a sparse one.
    """
    if isinstance(a, SparseLFT):
        return Regularity((Box(np.zeros(len(a.blocks)), np.ones(len(a.blocks))),))
    owner = np.repeat(np.arange(len(a.blocks)), [block.size for block in a.blocks])
    work, open_boxes = prove * _UNIT, []
    with budget(prove):
        for channels in _loops(a.M11):
            used, local = np.unique(owner[channels], return_inverse=True)
            matrix = a.M11[np.ix_(channels, channels)]
            loop = _Loop(matrix, local, len(used), np.eye(len(channels)) + np.abs(matrix))
            is_open, _, signs = _look(loop, np.zeros((1, loop.deltas)), np.ones((1, loop.deltas)))
            if not is_open[0] and signs[0] > 0.0:
                work -= loop.cost
                continue
            with after(prove - work / _UNIT):
                boxes, zero, work = _examine(_balanced(loop) if is_open[0] else loop, work)
            center, half = np.zeros(len(a.blocks)), np.ones(len(a.blocks))
            if zero is not None:
                center[used] = zero
                return Regularity((), center)
            for box in boxes:
                center[used], half[used] = box
                open_boxes.append(Box(center.copy(), half.copy()))
    return Regularity(tuple(open_boxes))


class _Loop(NamedTuple):
    """A strongly connected part, in coordinates T of the channels of each delta."""

    matrix: Array  # (n, n), T M11 T^-1
    owner: NDArray[np.int64]  # (n,), the delta of each channel
    deltas: int
    # (n, n), |T| (1 + |M11|) |T^-1|: entries of M11 that change by a fraction of themselves change
    # those of the loop by that fraction of this at most
    size: Array

    @property
    def cost(self) -> float:
        """Operations for one box; small matrices cost calls."""
        return 8.0 * len(self.matrix) ** 3 + 2.0e4


def _loops(matrix: Array) -> list[NDArray[np.int64]]:
    """Channels of the strongly connected parts of the graph that have loops."""
    if not len(matrix):
        return []
    count, label = connected_components(csr_array(matrix != 0.0), connection="strong")
    order = np.argsort(label, kind="stable")
    components = np.split(order, np.cumsum(np.bincount(label, minlength=count))[:-1])
    return [c for c in components if len(c) > 1 or matrix[c[0], c[0]] != 0.0]


def _balanced(loop: _Loop) -> _Loop:
    """The loop in coordinates in which the channels of each delta matter as much as they are reached.

    For each delta there are Gramians G, O that the loop reproduces, up to a factor: G = M11 G M11' and
    O = M11' O M11 in the diagonal blocks. T makes both one diagonal matrix.
    """
    M, n = loop.matrix, len(loop.matrix)
    same, eye = loop.owner[:, None] == loop.owner, np.eye(n)
    reached, seen = eye, eye
    for _ in range(_BALANCE):
        reached, seen = (
            np.where(same, gramian, 0.0) * (n / max(float(np.trace(gramian)), _TINY)) + _LIFT * eye
            for gramian in (M @ reached @ M.T, M.T @ seen @ M)
        )
    T, back = np.zeros((n, n)), np.zeros((n, n))
    for k in range(loop.deltas):
        block = np.ix_(*(2 * [np.flatnonzero(loop.owner == k)]))
        root = np.linalg.cholesky(reached[block])
        turn, sizes, _ = np.linalg.svd(root.T @ seen[block] @ root)
        back[block] = root @ turn * sizes**-0.25
        T[block] = np.linalg.inv(back[block])
    size = np.abs(T) @ loop.size @ np.abs(back)
    return loop._replace(matrix=T @ M @ back, size=size)


def _examine(loop: _Loop, work: float) -> tuple[list[Box], Array | None, float]:
    """Open boxes of a loop, a zero of its determinant, and what is left of the work."""
    centers, halves = np.zeros((1, loop.deltas)), np.ones((1, loop.deltas))
    small: list[Box] = []
    total = work
    while len(centers) and work >= 0.0 and len(small) <= _MOST_BOXES:
        some = slice(max(0, len(centers) - _CHUNK), None)  # the smallest first: memory stays bounded
        c, h = centers[some], halves[some]
        centers, halves = centers[: some.start], halves[: some.start]
        work -= len(c) * loop.cost
        tell((total - work) / _UNIT)
        is_open, slopes, signs = _look(loop, c, h)
        if np.any(signs <= 0.0):
            return [], _crossing(loop, c[int(np.argmin(signs))]), work
        c, h, slopes = c[is_open], h[is_open], slopes[is_open]
        worst = np.argmax(slopes, axis=1)
        ends = h[np.arange(len(h)), worst] <= _SMALLEST
        small += [Box(*pair) for pair in zip(c[ends], h[ends], strict=True)]
        c, h = _halved(c[~ends], h[~ends], worst[~ends])
        centers, halves = np.concatenate([centers, c]), np.concatenate([halves, h])
    boxes = small + [Box(*pair) for pair in zip(centers, halves, strict=True)]
    zero = _search(loop, boxes) if boxes else None
    if len(boxes) > _MOST_BOXES:  # too many to be listed: one that holds them
        low = np.min([box.center - box.half for box in boxes], axis=0)
        high = np.max([box.center + box.half for box in boxes], axis=0)
        boxes = [Box(0.5 * (low + high), 0.5 * (high - low))]
    return boxes, zero, work


def _look(loop: _Loop, c: Array, h: Array) -> tuple[NDArray[np.bool_], Array, Array]:
    """Whether boxes (N, q) stay open, how much each delta adds (N, q), signs of det at centers (N,)."""
    n, eye = len(loop.matrix), np.eye(len(loop.matrix))
    at, wide = c[:, loop.owner], h[:, loop.owner]
    system = eye - loop.matrix * at[:, None, :]
    signs, _ = np.linalg.slogdet(system)
    if np.any(signs == 0.0):
        return np.ones(len(c), dtype=bool), h, signs
    inverse = np.linalg.inv(system)
    product = inverse @ loop.matrix
    spread = np.abs(product) * wide[:, None, :]
    rounding = np.abs(inverse) @ loop.size
    P = np.abs(eye - inverse + product * at[:, None, :]) + spread + 2.0 * _NEAR * rounding
    is_open = ~_contracts(P, n)
    slopes = h.copy()
    if np.any(is_open):
        slopes[is_open] = _shares(loop, P[is_open], spread[is_open])
    return is_open, slopes, signs


def _contracts(P: Array, n: int) -> NDArray[np.bool_]:
    """Whether x > 0 with P x < x is found for each of the matrices (N, n, n) that are not negative."""
    ones = np.ones((len(P), n, 1))
    finite = np.all(np.isfinite(P), axis=(1, 2))
    try:
        x = np.linalg.solve(np.eye(n) - np.where(finite[:, None, None], P, 0.0), ones)
    except np.linalg.LinAlgError:
        x = ones
    larger = (P @ np.abs(x)) * (1.0 + 2.0 * _NEAR)
    return np.asarray(finite & np.all((x > 0.0) & (larger < x), axis=(1, 2)))


def _shares(loop: _Loop, P: Array, spread: Array) -> Array:
    """How much the width of each delta adds to the spectral radius of P: (N, q)."""
    right_vector = np.ones((len(P), P.shape[1], 1))
    left_vector = right_vector.transpose(0, 2, 1)
    for _ in range(_ITERATIONS):
        right_vector, left_vector = P @ right_vector, left_vector @ P
        right_vector = right_vector / np.maximum(np.max(right_vector, axis=1, keepdims=True), 1e-300)
        left_vector = left_vector / np.maximum(np.max(left_vector, axis=2, keepdims=True), 1e-300)
    share = (left_vector @ spread)[:, 0] * right_vector[:, :, 0]
    return np.stack([share[:, loop.owner == k].sum(axis=1) for k in range(loop.deltas)], axis=1)


def _halved(c: Array, h: Array, along: NDArray[np.int64]) -> tuple[Array, Array]:
    """Both halves of boxes, each cut along one delta; the numbers stay exact."""
    rows, h = np.arange(len(c)), h.copy()
    h[rows, along] *= 0.5
    step = np.zeros_like(c)
    step[rows, along] = h[rows, along]
    return np.concatenate([c - step, c + step]), np.concatenate([h, h])


def _search(loop: _Loop, boxes: list[Box]) -> Array | None:
    """A zero of the determinant that steps down its slope lead to, from the middles of some boxes."""
    picked = np.unique(np.linspace(0, len(boxes) - 1, _STARTS).astype(int))
    at = np.stack([boxes[k].center for k in picked])
    eye = np.eye(len(loop.matrix))
    for _ in range(_STEPS):
        system = eye - loop.matrix * at[:, None, loop.owner]
        signs, _ = np.linalg.slogdet(system)
        if np.any(signs <= 0.0):
            return _crossing(loop, at[int(np.argmin(signs))])
        diagonal = -np.einsum("nij,ji->ni", np.linalg.inv(system), loop.matrix)
        slope = np.stack([diagonal[:, loop.owner == k].sum(axis=1) for k in range(loop.deltas)], axis=1)
        steep = np.sum(slope * slope, axis=1, keepdims=True)
        before, at = at, np.clip(at - slope / np.maximum(steep, 1.0), -1.0, 1.0)
        if np.array_equal(at, before):
            break  # all are in corners
    return None


def _crossing(loop: _Loop, end: Array) -> Array:
    """A point between 0 and one where the determinant is not positive, at which its sign changes."""
    eye, low, high = np.eye(len(loop.matrix)), 0.0, 1.0
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        sign, _ = np.linalg.slogdet(eye - loop.matrix * (middle * end)[loop.owner])
        low, high = (middle, high) if sign > 0.0 else (low, middle)
    return np.asarray(high * end)


def physical_boxes(
    boxes: Sequence[Box], names: Sequence[str], parameters: Sequence[Parameter]
) -> tuple[tuple[tuple[float, float], ...], ...]:
    """Boxes of the deltas of these names, as lowest and highest physical values of all parameters."""
    physical = []
    for center, half in boxes:
        ends = {p.name: (p.low, p.high) for p in parameters}
        for p in parameters:
            if p.name in names:
                k = list(names).index(p.name)
                low, high = to_physical(p, [center[k] - half[k], center[k] + half[k]]).tolist()
                ends[p.name] = low, high
        physical.append(tuple(ends.values()))
    return tuple(physical)


def well_posed(
    lft: LFT, parameters: Sequence[Parameter], what: str, *, are_proved: bool
) -> dict[str, Any]:
    """Fields of a certificate on well-posedness, of a model that is made of others.

    Its trim is regular if theirs are; `are_proved` says whether they are proved to be.
    """
    if not lft.is_plain:
        return {"well_posed": SAMPLED, "open_boxes": ()}
    names, known = [block.name for block in lft.blocks], regularity(lft)
    check_no_zero(known, names, parameters, f"{what}: the model is singular", "")
    return {
        "well_posed": PROVED if known.is_proved and are_proved else SAMPLED,
        "open_boxes": physical_boxes(known.open_boxes, names, parameters),
    }


def check_no_zero(
    known: Regularity, names: Sequence[str], parameters: Sequence[Parameter], what: str, narrow: str
) -> None:
    """Raise a WellPosednessError at the point where the determinant vanishes, if one was found."""
    if known.zero is not None:
        (at,) = physical_boxes([Box(known.zero, np.zeros(len(names)))], names, parameters)
        values = at_values(parameters, [low for low, _ in at])
        raise WellPosednessError(
            f"{what} at {values}: the determinant of its equations vanishes there. Narrow the ranges"
            f"{narrow}."
        )
