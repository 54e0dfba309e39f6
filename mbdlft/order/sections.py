"""Sections of the sheaf of the columns of [H I], from values of an LFT in two or three deltas.

All other deltas are fixed; H(a, b) or H(a, b, c) is what is left, with n_in columns. F is the sheaf that
the columns of [H I] generate on the product of projective lines, G the bundle of the pairs (u, y) with
y = H u: docs/method.md, section "Pairs that cannot both be smallest".

For a value alpha of a, and polynomials u in the other deltas such that y = H(alpha, .) u is a polynomial
of the same degrees,

    f = (H u - y) / (a - alpha)

is a section of F. Those of k values alpha span a space E. With b alone and u of a degree below
l = D_b + 2, E is complete when it does not grow with the next value, and then k is at least kappa, the
largest degree of a in which the pairs on a line b = const are generated.

Functions are known by their values on circles of the complex plane, where monomials are orthogonal. A
rank counts only if the singular values fall by a large factor, and it is checked against D_a and D_b.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import takewhile
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.lft.lft import LFT
from mbdlft.order.circles import channels_at, pole_distance
from mbdlft.order.work import Work, product, singular_values, solutions

Complex = NDArray[np.complex128]
Degrees = Mapping[str, int]

_OUTER, _INNER = 0.9, 0.5  # circles of samples, and of the values alpha, over the nearest pole
_TURN = math.pi * (3.0 - math.sqrt(5.0))  # golden angle between values alpha: none comes back
_LARGEST = 10.0  # radius that the nearest pole may give to a circle
_EXTRA = 2  # samples more than needed
_MOST_COEFFICIENTS = {2: 300, 3: 200}  # of u, with so many deltas: what has more is left out
_CANCELED = 2.0**-44  # of the sizes of terms: what is left of them is rounding
_RANK = (2.0**-38, 2.0**-29)  # of the largest singular value: rounding is below, a rank is above
_SINE = (2.0**-20, 2.0**-8)  # of an angle to a space: below is inside, above is outside


class DoubtError(Exception):
    """A rank is not clear, or it contradicts a degree."""


class Obstruction(NamedTuple):
    """Why two deltas cannot both have their degree.

    Attributes
    ----------
    dimensions : h_1 = h, h_2, ... as far as they are not zero
        Of H^1(G(-1, -j)). h does not depend on which of the two deltas is the first.
    kappa : of the first delta
    characteristic : of G(-1, -1), after Euler; the same for both orders of the deltas
    """

    dimensions: tuple[int, ...]
    kappa: int
    characteristic: int

    @property
    def more(self) -> int:
        """Repetitions above its degree that the second needs if the first has none."""
        return max(math.ceil(h / self.kappa) + before for before, h in enumerate(self.dimensions))


class _Span(NamedTuple):
    """E: orthonormal values (samples, dimension) at points (samples) of unit circles; k values alpha."""

    basis: Complex
    points: Mapping[str, Complex]
    k: int


def compressed(a: LFT, source: LFT, random: np.random.Generator, work: Work) -> LFT:
    """Inputs and outputs that matter, in coordinates in which values on the circles have size one.

    The constant part has no part in it, as in all that follows. `source` is what `a` was made of by
    changes that leave rounding: an entry below that of its terms there is not there.
    """
    count = max(a.shape) + _EXTRA
    points = {
        name: _OUTER * _radius(a, name) * np.exp(2j * np.pi * random.uniform(size=count))
        for name, _ in a.blocks
    }
    for item in (a, source):
        work.add(solutions(count, item.order, item.shape[1]))
    high, wide = a.shape
    work.add(singular_values(2 * count * high, wide) + singular_values(2 * count * wide, high))
    left, right = _factors(a, points)
    terms = sum(np.abs(x) @ np.abs(y) for x, y in ((left, right), _factors(source, points)))
    H = np.where(np.abs(left @ right) > _CANCELED * terms, left @ right, 0.0)
    # as real and imaginary parts, so that the new coordinates are real
    inputs = _coordinates(np.vstack([part.reshape(-1, a.shape[1]) for part in (H.real, H.imag)]))
    H = np.swapaxes(H @ inputs, 1, 2)
    outputs = _coordinates(np.vstack([part.reshape(-1, a.shape[0]) for part in (H.real, H.imag)]))
    M12, M21 = a.M12 @ inputs, outputs.T @ a.M21
    return LFT(a.M11, M12, M21, outputs.T @ a.M22 @ inputs, a.blocks)


def _coordinates(rows: Array) -> Array:
    """T (columns, rank) such that the columns of rows @ T are orthonormal and span those of rows."""
    sizes = np.max(np.abs(rows), axis=0)
    scale = np.where(sizes > 0, 1.0 / np.where(sizes > 0, sizes, 1.0), 0.0)
    _, values, right = np.linalg.svd(rows * scale, full_matrices=False)
    rank = _rank(values)
    return np.asarray(scale[:, None] * right[:rank].T / values[:rank])


def obstruction(
    H: LFT, first: str, second: str, degrees: Degrees, random: np.random.Generator, work: Work
) -> Obstruction:
    """h and kappa of an LFT in two deltas, the first of them called a and the second b above.

    X_j = H^1(G(-1, -j)) are the f with f and b^(l+j-1) f in E.

    Raises
    ------
    DoubtError
    """
    degree = degrees[second]
    if H.shape[1] <= 1:
        return Obstruction((), 1, degrees[first] * degree)  # G is a line bundle
    length = degree + 2
    E = _span(H, first, {second: length}, degrees, degree, random, work)
    size, b = E.basis.shape[1], E.points[second]
    if size - _inside(E.basis, (b, 1)) != degrees[first]:
        raise DoubtError
    # the points of the circle tell functions of these degrees apart, and no higher ones
    dimensions = takewhile(bool, (_inside(E.basis, (b, length + j)) for j in range(_EXTRA + 1)))
    return Obstruction(tuple(dimensions), E.k, degrees[first] * length - size)


def is_constant_in(
    H: LFT,
    first: str,
    second: str,
    third: str,
    degrees: Degrees,
    random: np.random.Generator,
    work: Work,
) -> bool:
    """Whether an LFT in three deltas has a section of F(-1, -1, 0).

    That is an obstruction of the first two that has no pole in the third, not at infinity either. It is
    looked for among the f of polynomials u of degree 1 in the third, so it may exist and not be found.

    Raises
    ------
    DoubtError
    """
    lengths = {second: degrees[second] + 2, third: 2}
    E = _span(H, first, lengths, degrees, None, random, work)
    b, c = (E.points[name] for name in lengths)
    power = lengths[second]
    return _inside(E.basis, (b, power), (c, 1), (b**power * c, 1)) > 0


class _Samples(NamedTuple):
    """Where functions are known: a (N) on circles of the first delta, the others on unit circles.

    `left` (N, outputs) are the directions in which they are seen there, `powers` (N, coefficients) the
    monomials of u.
    """

    a: Complex
    points: Mapping[str, Complex]
    left: Array
    powers: Complex


def _samples(
    H: LFT,
    first: str,
    lengths: Mapping[str, int],
    circles: Mapping[str, Complex],
    degrees: Degrees,
    random: np.random.Generator,
) -> _Samples:
    """Samples that tell apart all functions (H u - y) / (a - alpha) of u with so many powers."""
    second, *others = lengths
    count = degrees[first] + _EXTRA
    circle = _circle(count * math.prod(lengths[name] for name in others), random)
    outer = _OUTER * _radius(H, first) * circle
    on_circle = len(circles[second])
    points = {second: np.tile(circles[second], len(outer))}
    for name in others:
        point = np.exp(2j * np.pi * random.uniform(size=len(outer)))
        points[name] = np.repeat(point, on_circle)
    left = np.repeat(random.standard_normal((len(outer), H.shape[0])), on_circle, axis=0)
    a = np.repeat(outer, on_circle)
    powers = np.ones((len(a), 1), dtype=complex)
    for name, length in lengths.items():
        own = np.vander(points[name], length, increasing=True) / math.sqrt(len(circles[name]))
        powers = (powers[:, :, None] * own[:, None, :]).reshape(len(a), -1)
    return _Samples(a, points, left, powers)


def _span(
    H: LFT,
    first: str,
    lengths: Mapping[str, int],
    degrees: Degrees,
    rank: int | None,
    random: np.random.Generator,
    work: Work,
) -> _Span:
    """E of the polynomials u with so many powers of each delta but the first.

    `rank` is that of the conditions for u, if it is known.
    """
    p, q = H.shape
    if q * math.prod(lengths.values()) > _MOST_COEFFICIENTS[1 + len(lengths)]:
        raise DoubtError
    radii = {name: _OUTER * _radius(H, name) for name in lengths}
    circles = {
        name: _circle(2 * length + degrees[name] + _EXTRA, random)
        for name, length in lengths.items()
    }
    grid = np.meshgrid(*circles.values(), indexing="ij")
    on_grid = {name: axis.ravel() for name, axis in zip(circles, grid, strict=True)}
    modes, low, is_low = [], np.ones((1, 1), dtype=complex), np.ones(1, dtype=bool)
    for name, circle in circles.items():
        modes.append(np.vander(circle, increasing=True) / math.sqrt(len(circle)))  # unitary
        low = np.kron(low, modes[-1][:, : lengths[name]])
        is_low = np.kron(is_low, np.arange(len(circle)) < lengths[name])
    a, points, left, powers = _samples(H, first, lengths, circles, degrees, random)

    def values(a: Complex, others: Mapping[str, Complex]) -> Complex:
        work.add(solutions(len(a), H.order, q) + product(len(a) * p, H.order, q))
        return _values(H, {first: a, **{name: radii[name] * others[name] for name in lengths}})

    seen = np.einsum("si,sij->sj", left, values(a, points))
    all_Hu = np.einsum("sj,sn->snj", seen, powers).reshape(len(a), -1)
    E, turn = np.zeros((len(a), 0), dtype=complex), random.uniform(0, 2 * np.pi)
    for k in range(2 * degrees[first] + 2):
        alpha = _INNER * _radius(H, first) * np.exp(1j * (turn + k * _TURN))
        value = values(np.full(len(low), alpha), on_grid)
        products = _coefficients(np.einsum("bij,bn->binj", value, low), modes)
        # H u is a polynomial if it has no high modes
        u = _null_space(products[~is_low].reshape(-1, all_Hu.shape[1]), rank, work)
        y = products[is_low].reshape(low.shape[1], p, -1) @ u
        all_y = np.einsum("si,siu->su", left, np.tensordot(powers, y, 1))
        work.add(product(p * len(a), powers.shape[1], 4 * u.shape[1]))
        sections = (all_Hu @ u - all_y) / (a - alpha)[:, None]
        work.add(2.0 * singular_values(len(a), E.shape[1] + u.shape[1]))
        basis, sizes, _ = np.linalg.svd(np.hstack([E, sections]), full_matrices=False)
        size = _rank(sizes)
        if size == E.shape[1]:
            return _Span(basis[:, :size], points, k)
        E = basis[:, :size] * sizes[:size]
    raise DoubtError


def _coefficients(values: Complex, modes: Sequence[Complex]) -> Complex:
    """Of the modes of all circles in values (grid, ...), as an array (modes, ...)."""
    coefficients = values.reshape(*(len(own) for own in modes), -1)
    for own in modes:  # the axis of each comes first in its turn, and last in the end
        turned = np.tensordot(own.conj().T, coefficients, 1)
        coefficients = np.moveaxis(turned, 0, len(modes) - 1)
    return coefficients.reshape(values.shape)


def _radius(a: LFT, name: str) -> float:
    """Of a circle with most poles outside, not far, when the other deltas are small."""
    part = a.slices()[name]
    return pole_distance(a.M11[part, part], _LARGEST)


def _circle(count: int, random: np.random.Generator) -> Complex:
    """Points of the unit circle at equal distances (count), turned by chance."""
    return np.asarray(np.exp(2j * np.pi * (np.arange(count) + random.uniform()) / count))


def _values(a: LFT, points: Mapping[str, Complex]) -> Complex:
    """Values (N, n_out, n_in) at complex points (N) of all deltas, without the constant part."""
    left, right = _factors(a, points)
    return left @ right


def _factors(a: LFT, points: Mapping[str, Complex]) -> tuple[Complex, Complex]:
    """M21 Delta (N, n_out, n) and (I - M11 Delta)^-1 M12 (N, n, n_in)."""
    spread = np.stack([points[name] for name, size in a.blocks for _ in range(size)], axis=1)
    return a.M21 * spread[:, None, :], channels_at(a.M11, a.M12, spread)


def _rank(values: Array) -> int:
    """How many singular values, the largest first, are not rounding."""
    if not values.size or not np.all(np.isfinite(values)):
        raise DoubtError
    noise, clear = (part * values[0] for part in _RANK)
    if np.any((values > noise) & (values <= clear)):
        raise DoubtError
    return int(np.sum(values > clear))


def _null_space(matrix: Complex, rank: int | None, work: Work) -> Complex:
    """Orthonormal vectors (columns, columns - rank) of the null space of a matrix."""
    if len(matrix) > matrix.shape[1]:
        work.add(product(len(matrix), matrix.shape[1], 4 * matrix.shape[1]))
        matrix = np.asarray(np.linalg.qr(matrix, mode="r"))
    work.add(2.0 * singular_values(*matrix.shape))
    _, values, right = np.linalg.svd(matrix)
    clear = _rank(values)
    if rank is not None and clear != rank:
        raise DoubtError
    return np.asarray(right[clear:].conj().T)


def _inside(basis: Complex, *moves: tuple[Complex, int]) -> int:
    """Dimension of the functions f in the span of an orthonormal basis with all b^power f in it too.

    Multiplication by b, of size one, is an isometry.
    """
    left = [b[:, None] ** power * basis for b, power in moves]
    left = [moved - basis @ (basis.conj().T @ moved) for moved in left]
    sines = np.linalg.svd(np.concatenate(left), compute_uv=False)
    inside, outside = _SINE
    if np.any((sines > inside) & (sines <= outside)):
        raise DoubtError
    return int(np.sum(sines <= inside))
