"""Lower bound on the order of an LFT: pairs of deltas that cannot both have their McMillan degree.

Fix all deltas but a and b. What is left is H(a, b) with n_in columns, of McMillan degrees D_a and D_b.
The pairs (u, y) of polynomials with y = H u are a vector bundle G on the product of two projective
lines. From an LFT with D_a and D_b repetitions follows X = H^1(G(-1, -1)) = 0. So if h = dim X > 0 there
is none: if a has D_a repetitions, b has at least D_b + h/kappa, where on every line b = const the
pairs are generated in degree kappa of a at most. Theorems and proofs: docs/method.md, section "Pairs
that cannot both be smallest".

In numbers: for a value alpha of a, and u(b) such that u(b) and H(alpha, b) u(b) are polynomials of degree
below l = D_b + 2,

    f(a, b) = (H(a, b) - H(alpha, b)) u(b) / (a - alpha)

is a section of the sheaf of the columns of [H I]. Those of k values alpha span a space E. When it does
not grow with the next value, kappa <= k and E is complete, and X is the f with f and b^l f in E.

Functions are known by their values on circles of the complex plane, where monomials are orthogonal. A
rank counts only if the singular values fall by a large factor, and it is checked against D_a and D_b;
otherwise the pair does not count.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import combinations, takewhile
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.errors import WellPosednessError
from mbdlft.lft.lft import LFT, Array, check, fix, transpose
from mbdlft.lft.lines import channels_at, pole_distance
from mbdlft.lft.reduce import reduce_order

Complex = NDArray[np.complex128]
Degrees = Mapping[str, int]

_FIXINGS, _TRIES = 2, 4  # values of the other deltas that have to agree, and that are tried
_CENTER = 0.6  # of the range of a delta, where these values are taken
_OUTER, _INNER = 0.9, 0.5  # circles of samples, and of the values alpha, over the nearest pole
_TURN = math.pi * (3.0 - math.sqrt(5.0))  # golden angle between values alpha: none comes back
_LARGEST = 10.0  # radius that the nearest pole may give to a circle
_EXTRA = 2  # samples more than needed
_MOST_COEFFICIENTS = 300  # of u; a larger pair is left out
_CANCELED = 2.0**-44  # of the sizes of terms: what is left of them is rounding
_RANK = (2.0**-38, 2.0**-29)  # of the largest singular value: rounding is below, a rank is above
_SINE = (2.0**-20, 2.0**-8)  # of an angle to a space: below is inside, above is outside


class Pair(NamedTuple):
    """Two deltas that do not both have their degree.

    `second_more` are the repetitions above its degree that the second needs if the first has none, and
    the other way round. Both are at least 1.
    """

    first: str
    second: str
    first_more: int
    second_more: int


class _Obstruction(NamedTuple):
    """h_1 = h, h_2, ... as far as they are not zero; kappa of the first delta; the Euler
    characteristic of G(-1, -1).

    h and the characteristic do not depend on which of the two deltas is the first.
    """

    dimensions: tuple[int, ...]
    kappa: int
    characteristic: int

    @property
    def more(self) -> int:
        """Repetitions above its degree that the second needs if the first has none."""
        return max(math.ceil(h / self.kappa) + before for before, h in enumerate(self.dimensions))


class _DoubtError(Exception):
    """A rank is not clear, or it contradicts a degree."""


def joint_bound(a: LFT, degrees: Degrees, stop: Callable[[], bool] = lambda: False) -> int:
    """Proved minimum of the order of any exact LFT of the same matrix.

    Parameters
    ----------
    a : LFT
    degrees : mapping of names to McMillan degrees
        As from `lower_bound`.
    stop : function
        Asked before each pair whether the time is over; pairs that were not looked at do not count.

    Returns
    -------
    int
        At least the sum of the degrees; what is not clear numerically does not count.

    Raises
    ------
    StructureError
        A delta has no degree.
    """
    pairs = pair_bounds(a, degrees, stop=stop)
    names = [block.name for block in a.blocks]
    return sum(degrees[name] for name in names) + least_more(names, pairs)


def pair_bounds(
    a: LFT, degrees: Degrees, seed: int = 0, stop: Callable[[], bool] = lambda: False
) -> tuple[Pair, ...]:
    """The pairs of deltas of an LFT that are proved not to have both their degree.

    A pair that `a` itself contradicts has a wrong rank, and is left out. A pair may come twice, once for
    `a` and once for its transpose.

    Raises
    ------
    StructureError
        A delta has no degree.
    """
    missing = [block.name for block in a.blocks if block.name not in degrees]
    check(not missing, f"the degrees of {missing} are missing, got those of {list(degrees)}")
    random = np.random.default_rng(seed)
    more = {block.name: block.size - degrees[block.name] for block in a.blocks}
    names = [name for name in more if degrees[name]]
    found = [
        _pair(one, first, second, degrees, random)
        for first, second in combinations(names, 2)
        for one in (a, transpose(a))
        if not stop()
    ]
    return tuple(pair for pair in found if pair is not None and _allows(pair, more))


def least_more(names: Sequence[str], pairs: Sequence[Pair]) -> int:
    """Least sum of repetitions above the degrees that all pairs allow.

    With e >= 0 repetitions more, e_first = 0 implies e_second >= second_more if and only if
    second_more e_first + e_second >= second_more.
    """
    if not pairs:
        return 0
    from scipy.optimize import LinearConstraint, milp  # here because it is slow to import

    rows, least = np.zeros((2 * len(pairs), len(names))), np.zeros(2 * len(pairs))
    for k, pair in enumerate(pairs):
        i, j = names.index(pair.first), names.index(pair.second)
        rows[2 * k, [i, j]], least[2 * k] = (pair.second_more, 1), pair.second_more
        rows[2 * k + 1, [i, j]], least[2 * k + 1] = (1, pair.first_more), pair.first_more
    ones = np.ones(len(names))
    program = milp(ones, constraints=LinearConstraint(rows, lb=least), integrality=ones)
    return round(float(program.fun))


def _allows(pair: Pair, more: Mapping[str, int]) -> bool:
    """Whether these repetitions above the degrees are possible."""
    first, second = more[pair.first], more[pair.second]
    return (first > 0 or second >= pair.second_more) and (second > 0 or first >= pair.first_more)


def _pair(
    a: LFT, first: str, second: str, degrees: Degrees, random: np.random.Generator
) -> Pair | None:
    """What is proved for two deltas at several values of the others; the least of it."""
    clear: list[Pair] = []
    for _ in range(_TRIES):
        others = {
            block.name: float(random.uniform(-_CENTER, _CENTER))
            for block in a.blocks
            if block.name not in (first, second)
        }
        try:
            found = _pair_at(reduce_order(fix(a, others)), first, second, degrees, random)
        except (_DoubtError, WellPosednessError, np.linalg.LinAlgError):
            continue
        if found is None:
            return None
        clear.append(found)
        if len(clear) == _FIXINGS:
            return Pair(
                first,
                second,
                min(pair.first_more for pair in clear),
                min(pair.second_more for pair in clear),
            )
    return None


def _pair_at(
    a: LFT, first: str, second: str, degrees: Degrees, random: np.random.Generator
) -> Pair | None:
    """The same for an LFT in these two deltas; None if they can both have their degree."""
    if a.order == degrees[first] + degrees[second]:
        return None
    H = _compressed(a, random)
    forth = _obstruction(H, first, second, degrees, random)
    if not forth.dimensions:
        return None
    back = _obstruction(H, second, first, degrees, random)
    same = forth.dimensions[:1] == back.dimensions[:1]
    if not same or forth.characteristic != back.characteristic:
        raise _DoubtError
    return Pair(first, second, back.more, forth.more)


def _compressed(a: LFT, random: np.random.Generator) -> LFT:
    """Inputs and outputs that matter, in coordinates in which values on the circles have size one.

    The constant part has no part in it, as in all that follows.
    """
    count = max(a.shape) + _EXTRA
    points = {
        name: _OUTER * _radius(a, name) * np.exp(2j * np.pi * random.uniform(size=count))
        for name, _ in a.blocks
    }
    left, right = _factors(a, points)
    # an entry of terms that cancel is not there
    H = np.where(
        np.abs(left @ right) > _CANCELED * (np.abs(left) @ np.abs(right)), left @ right, 0.0
    )
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


def _obstruction(
    H: LFT, first: str, second: str, degrees: Degrees, random: np.random.Generator
) -> _Obstruction:
    """h and kappa of an LFT in two deltas, the first of them called a and the second b above."""
    q, degree = H.shape[1], degrees[second]
    if q <= 1:
        return _Obstruction((), 1, degrees[first] * degree)  # G is a line bundle
    length = degree + 2
    if q * length > _MOST_COEFFICIENTS:
        raise _DoubtError
    across, along = (_radius(H, name) for name in (first, second))
    circle = _circle(2 * length + degree + _EXTRA, random)
    modes = np.vander(circle, len(circle), increasing=True) / math.sqrt(len(circle))  # unitary
    low, high = modes[:, :length], modes[:, length:]
    outer = _OUTER * across * _circle(degrees[first] + _EXTRA, random)
    left = random.standard_normal((len(outer), H.shape[0]))

    def values(a: Complex) -> Complex:
        """H (a, b, outputs, inputs) at values of a and on the circle of b."""
        points = {
            first: np.repeat(a, len(circle)),
            second: np.tile(_OUTER * along * circle, len(a)),
        }
        return _values(H, points).reshape(len(a), len(circle), *H.shape)

    seen = np.einsum("ai,abij->abj", left, values(outer))
    E, turn = np.zeros((len(outer) * len(circle), 0), dtype=complex), random.uniform(0, 2 * np.pi)
    for k in range(2 * degrees[first] + 2):
        alpha = _INNER * across * np.exp(1j * (turn + k * _TURN))
        (value,) = values(np.array([alpha]))
        # H u is a polynomial if it has no high modes
        products = np.einsum("bm,bij,bn->minj", high.conj(), value, low, optimize=True)
        u = _null_space(products.reshape(-1, length * q), degree)
        quotients = (seen - np.einsum("ai,bij->abj", left, value)) / (outer - alpha)[:, None, None]
        sections = np.einsum("abj,bn->abnj", quotients, low).reshape(len(E), length * q) @ u
        basis, sizes, _ = np.linalg.svd(np.hstack([E, sections]), full_matrices=False)
        size = _rank(sizes)
        if size == E.shape[1]:
            break
        E = basis[:, :size] * sizes[:size]
    else:
        raise _DoubtError
    basis, b = basis[:, :size], np.tile(circle, len(outer))
    if size - _inside(basis, b, 1) != degrees[first]:
        raise _DoubtError
    # the points of the circle tell functions of these degrees apart, and no higher ones
    dimensions = takewhile(bool, (_inside(basis, b, length + j) for j in range(_EXTRA + 1)))
    return _Obstruction(tuple(dimensions), k, degrees[first] * length - size)


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
        raise _DoubtError
    noise, clear = (part * values[0] for part in _RANK)
    if np.any((values > noise) & (values <= clear)):
        raise _DoubtError
    return int(np.sum(values > clear))


def _null_space(matrix: Complex, rank: int) -> Complex:
    """Orthonormal vectors (columns, columns - rank) of the null space of a matrix of known rank."""
    if len(matrix) > matrix.shape[1]:
        matrix = np.asarray(np.linalg.qr(matrix, mode="r"))
    _, values, right = np.linalg.svd(matrix)
    if _rank(values) != rank:
        raise _DoubtError
    return np.asarray(right[rank:].conj().T)


def _inside(basis: Complex, b: Complex, power: int) -> int:
    """Dimension of the functions f in the span of an orthonormal basis with b^power f in it too.

    Multiplication by b, of size one, is an isometry.
    """
    moved = b[:, None] ** power * basis
    sines = np.linalg.svd(moved - basis @ (basis.conj().T @ moved), compute_uv=False)
    inside, outside = _SINE
    if np.any((sines > inside) & (sines <= outside)):
        raise _DoubtError
    return int(np.sum(sines <= inside))
