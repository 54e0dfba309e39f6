"""Lower bounds of repetitions from doubles: McMillan degrees, as ranks of Loewner matrices.

A system that is wired of models has no exact numbers; those that have are bounded on residues
(`mbdlft.order.lower_bound`). Fix all deltas but one at generic values. In that one, z, what is left is

    H(z) = H(0) + z C (I - z A)^-1 B,

and every exact LFT of the same matrix repeats that delta at least as often as the McMillan degree of H.
For points lambda_a, mu_b and directions l_a, r_b the Loewner matrix

    L_ab = l_a' (H(lambda_a) - H(mu_b)) r_b / (lambda_a - mu_b)
         = l_a' C (I - lambda_a A)^-1 (I - mu_b A)^-1 B r_b

has a rank that is not above the McMillan degree, and equal to it for generic points and directions.
The points stand on a circle, lambda and mu in turn: there L is close to a unitary transformation of the
Hankel matrix. Where that leaves a doubt they stand on rings about the poles.

Rounding: if L is known up to an error E, sigma_k(L) > ||E|| proves rank >= k (Weyl; Golub, Van Loan,
Matrix computations, section 8.6). E is measured on a twin: the matrix from data in which every entry is
moved by what may be wrong with it, far more than rounding. Directions are scaled such that the error is
of one size in all rows and columns of L: what is only rounding does not count, and what is small but
accurate counts.

Antoulas, Anderson: On the scalar rational interpolation problem, 1986. Mayo, Antoulas: A framework for
the solution of the generalized realization problem, 2007.

What is proved of pairs and triples of deltas (`mbdlft.order.lower_bound`) excludes repetitions: a set of
linear inequalities of those above the degrees, whose least sum is an integer program.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations, count
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import rsf2csf, schur

from mbdlft.base.array import Array
from mbdlft.lft.lft import LFT, check_plain
from mbdlft.order.reduction import balance

_POINTS = 3  # generic values of the other deltas; the next are for what is doubtful at the first
_UNCERTAIN = 2.0**-44  # of the size of an entry of the LFT, what may be wrong with it
_UNLUCKY = 2.0**-46  # of the terms of an entry of L: the least error, whatever cancels in the twin
_CLEAR = 64.0  # a singular value counts from this many times the error on; the error is one sample
_ROUNDING = 1.0 / 16.0  # of the error: below it is rounding, and between the two it is in doubt
_MORE_POINTS = 2  # on the circle than the degree needs
_CENTER = 0.6  # of the range of a delta, where generic values are taken
_INSIDE = 0.9  # radius of the circle over the distance of the nearest pole
_CLOSE = 0.3  # of the distance of a pole from zero: others that near are in one ring with it
_SCALINGS = 3  # of rows and columns, until the error is of one size
_RINGS = (0.5, 0.2)  # radii of rings over the distance to the next
_AROUND = 1.5  # times the distance of the poles from their center, a ring has at least
_FAR = 1e-3  # of the largest reciprocal of a pole: smaller ones are poles at infinity


class Bound(NamedTuple):
    """Proved repetitions of a delta, and singular values neither clear nor clearly rounding."""

    degree: int
    doubtful: int


class _Realization(NamedTuple):
    """A, B, C of H(0) + C Z (I - A Z)^-1 B, with Z the deltas; H(0) has no part in degrees."""

    A: NDArray[Any]
    B: NDArray[Any]
    C: NDArray[Any]


def degree_bounds(a: LFT, twin: LFT | None = None, seed: int = 0) -> dict[str, Bound]:
    """Proved minima of the repetitions of each delta in any exact LFT of the same matrix.

    When a numerical rank is not clear, the smaller value is given, and what rounding may hide. `twin` is
    the same matrix with the error that `a` may have, in any number of channels: what became of `moved`
    data in the computation that gave `a`. By default it is `a` itself, moved.
    """
    check_plain(a, "the lower bound")
    random = np.random.default_rng(seed)
    bounds = {block.name: Bound(0, block.size) for block in a.blocks}
    lfts = (a, moved(a, seed) if twin is None else twin)
    realizations = [_realization(item) for item in lfts]
    for _ in range(_POINTS):
        values = {block.name: random.uniform(-_CENTER, _CENTER) for block in a.blocks}
        doubtful = [name for name, bound in bounds.items() if bound.doubtful]
        if not doubtful:
            break
        with np.errstate(all="ignore"):  # what overflows is not finite, and proves nothing
            expanded = [
                _expanded(
                    realization,
                    np.repeat([values[b.name] for b in item.blocks], [b.size for b in item.blocks]),
                )
                for item, realization in zip(lfts, realizations, strict=True)
            ]
            for name in doubtful:
                alone = [
                    _alone(realization, item.slices()[name], values[name])
                    for item, realization in zip(lfts, expanded, strict=True)
                ]
                if all(np.all(np.isfinite(realization.A)) for realization in alone):
                    try:
                        first, second = (_triangular(realization) for realization in alone)
                        bound = _bound(first, second, random)
                    except np.linalg.LinAlgError:  # the iteration has no end; it proves nothing
                        continue
                    bounds[name] = max(bounds[name], bound, key=preference)
    return bounds


def moved(a: LFT, seed: int = 0, error: float = 0.0) -> LFT:
    """An LFT with every entry moved by what may be wrong with it, far more than rounding.

    `error` is what is known to be wrong with its values [1], if that is more. With channels and signals
    scaled, an entry is taken for a sum of terms of the size of its row and of its column. One that is
    zero is zero by structure.
    """
    core, inputs, outputs = balance(a)
    n = a.order
    exact = np.block([[core.M11, core.M12], [core.M21, a.M22 / outputs[:, None] / inputs]])
    rows, columns = (np.sqrt(np.sum(exact**2, axis=axis)) for axis in (1, 0))
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], exact.shape)
    share = max(_UNCERTAIN, error)
    M = exact + np.where(exact != 0.0, share * np.minimum(rows[:, None], columns) * signs, 0.0)
    M[n:] *= outputs[:, None]
    M[:, n:] *= inputs
    return LFT(M[:n, :n], M[:n, n:], M[n:, :n], M[n:, n:], a.blocks)


def _realization(a: LFT) -> _Realization:
    """The LFT with its channels scaled; signals keep their units."""
    core, inputs, outputs = balance(a)
    return _Realization(core.M11, core.M12 * inputs, core.M21 * outputs[:, None])


def _expanded(realization: _Realization, center: Array) -> _Realization:
    """The same in the distances of all deltas from a center (n)."""
    n = len(center)
    try:
        solved = np.linalg.solve(
            np.eye(n) - realization.A * center, np.hstack([realization.A, realization.B])
        )
    except np.linalg.LinAlgError:  # the center is a pole
        solved = np.full((n, n + realization.B.shape[1]), np.nan)
    return _Realization(
        solved[:, :n], solved[:, n:], realization.C + (realization.C * center) @ solved[:, :n]
    )


def _alone(realization: _Realization, rows: slice, center: float) -> _Realization:
    """One delta with the others at the center; it is itself counted from 0 again."""
    alone = _Realization(realization.A[rows, rows], realization.B[rows], realization.C[:, rows])
    return _expanded(alone, np.full(len(alone.A), -center))


def _triangular(realization: _Realization) -> _Realization:
    """The same with A upper triangular; the real iteration ends where the complex one may not."""
    try:
        A, Q = schur(realization.A, output="complex")
    except np.linalg.LinAlgError:
        A, Q = rsf2csf(*schur(realization.A))
    return _Realization(A, Q.conj().T @ realization.B, realization.C @ Q)


def _bound(realization: _Realization, twin: _Realization, random: np.random.Generator) -> Bound:
    """What the first points without a doubt prove, or else the best ones."""
    bounds = []
    for points in _points(realization.A, random):
        bounds.append(_degree(realization, twin, points, random))
        if not bounds[-1].doubtful:
            break
    return max(bounds, key=preference)


def preference(bound: Bound) -> tuple[int, int]:
    """The largest degree is proved; one point that shows it clearly is enough."""
    return bound.degree, -bound.doubtful


def _points(A: NDArray[Any], random: np.random.Generator) -> Iterator[NDArray[Any]]:
    """Points lambda, mu in turn: circles with all poles outside, the unit circle, rings about the poles.

    On the second circle powers of z A do not vanish. Rings show poles of high order and poles that are
    close to each other, which are felt little from afar.
    """
    count = len(A) + _MORE_POINTS
    poles, norm = float(np.max(np.abs(np.diagonal(A)))), float(np.linalg.norm(A, 2))
    for size in (poles, norm):
        yield _circle(_INSIDE / size if size > _UNCERTAIN else 1.0, count, random)
    yield _circle(1.0, count, random)
    for share in _RINGS:
        rings = _rings(np.diagonal(A), share)
        circles = [c + _circle(radius, m + _MORE_POINTS, random) for c, radius, m in rings]
        yield np.concatenate(circles)


def _circle(radius: float, count: int, random: np.random.Generator) -> NDArray[Any]:
    angles = (np.arange(2 * count) + random.uniform()) * np.pi / count
    return np.asarray(radius * np.exp(1j * angles))


def _rings(reciprocals: NDArray[Any], share: float) -> list[tuple[complex, float, int]]:
    """Centers, radii, numbers of circles about close poles, which are given by reciprocals."""
    near = np.abs(reciprocals) > _FAR * np.max(np.abs(reciprocals))
    poles = 1.0 / reciprocals[near]
    groups: list[NDArray[Any]] = []
    while len(poles):
        close = np.abs(poles - poles[0]) <= _CLOSE * np.abs(poles[0])
        groups.append(poles[close])
        poles = poles[~close]
    centers = np.array([np.mean(group) for group in groups])
    rings = []
    for k, group in enumerate(groups):
        away = np.append(np.delete(np.abs(centers - centers[k]), k), np.abs(centers[k]))
        spread = np.max(np.abs(group - centers[k]))
        radius = max(share * float(np.min(away)), _AROUND * float(spread))
        rings.append((complex(centers[k]), radius, len(group)))
    if not np.all(near):
        largest = 2.0 * float(np.max(np.abs(centers), initial=0.0)) or 1.0
        rings.append((0j, largest, int(np.sum(~near))))
    return rings


def _degree(
    realization: _Realization, twin: _Realization, points: NDArray[Any], random: np.random.Generator
) -> Bound:
    """What the Loewner matrix at points lambda, mu in turn proves."""
    most, count = len(realization.A), len(points) // 2
    some = points[:: max(1, count // 2)]
    derivatives, others = (_derivatives(item, some) for item in (realization, twin))
    largest, error = np.max(np.abs(derivatives), axis=0), np.max(np.abs(others - derivatives), axis=0)
    rows, columns = _noise_scales(largest, error)
    outputs = rows[:, None] * random.standard_normal((len(rows), count))
    inputs = columns[:, None] * random.standard_normal((len(columns), count))
    factors = [
        (_left(item.A, points[::2], item.C.T @ outputs).T, _right(item.A, points[1::2], item.B @ inputs))
        for item in (realization, twin)
    ]
    L, other = (X @ Y for X, Y in factors)
    # where terms cancel, so may their errors in one twin
    rounding = _UNLUCKY * (np.abs(factors[0][0]) @ np.abs(factors[0][1]))
    for _ in range(_SCALINGS):
        rows, columns = _noise_scales(np.abs(L), np.maximum(np.abs(other - L), rounding))
        L, other, rounding = (rows[:, None] * item * columns for item in (L, other, rounding))
    if not (np.all(np.isfinite(L)) and np.all(np.isfinite(other))):
        return Bound(0, most)
    values = np.linalg.svd(L, compute_uv=False)
    noise = max(np.linalg.norm(other - L, 2), np.linalg.norm(rounding, 2))
    degree = min(most, int(np.sum(values > _CLEAR * noise)))
    possible = min(most, int(np.sum(values > _ROUNDING * noise)))
    return Bound(degree, possible - degree)


def _derivatives(realization: _Realization, points: NDArray[Any]) -> NDArray[Any]:
    """C (I - z A)^-2 B at each point z, (number of points, n_out, n_in)."""
    from_outputs, from_inputs = (
        solve(realization.A, np.repeat(points, columns.shape[1]), np.tile(columns, len(points)))
        .reshape(len(columns), len(points), columns.shape[1])
        .swapaxes(0, 1)
        for solve, columns in ((_left, realization.C.T), (_right, realization.B))
    )
    return np.asarray(from_outputs.swapaxes(1, 2) @ from_inputs)


def _noise_scales(size: Array, error: Array) -> tuple[Array, Array]:
    """Scales of rows and columns that give errors a mean square of one; 0 where all is zero."""
    error = np.maximum(error, _UNCERTAIN * size)
    rows = _reciprocal(np.sqrt(np.mean(error**2, axis=1)))
    columns = _reciprocal(np.sqrt(np.mean((rows[:, None] * error) ** 2, axis=0)))
    return rows, columns


def _reciprocal(values: Array) -> Array:
    used = values != 0.0
    return np.where(used, 1.0 / np.where(used, values, 1.0), 0.0)


def _right(A: NDArray[Any], points: NDArray[Any], columns: NDArray[Any]) -> NDArray[Any]:
    """(I - z_k A)^-1 c_k for each point z_k and column c_k (n, points); A is upper triangular."""
    X = columns.astype(complex)
    for i in reversed(range(len(X))):
        X[i] = (X[i] + points * (A[i, i + 1 :] @ X[i + 1 :])) / (1.0 - points * A[i, i])
    return X


def _left(A: NDArray[Any], points: NDArray[Any], columns: NDArray[Any]) -> NDArray[Any]:
    """The same for A', which is upper triangular in the opposite order."""
    return _right(A.T[::-1, ::-1], points, columns[::-1])[::-1]


_MOST_TRIED = 3000  # attempts at small sums, which take some hundredths of a second

_Condition = tuple[Mapping[str, int], int]


class Pair(NamedTuple):
    """Two deltas that do not both have their degree.

    `second_more` are the repetitions above its degree that the second needs if the first has none, and
    the other way round. Both are at least 1. For all y, x, h of `shared`, y e_first + x e_second >= h.
    `is_transposed` says whether it is proved for H or for its transpose.
    """

    first: str
    second: str
    first_more: int
    second_more: int
    shared: tuple[tuple[int, int, int], ...] = ()
    is_transposed: bool = False


class Triple(NamedTuple):
    """If the last two deltas have their degree, the first has at least two repetitions above its own."""

    first: str
    second: str
    third: str
    is_transposed: bool = False


def least_more(
    names: Sequence[str],
    pairs: Sequence[Pair],
    triples: Sequence[Triple] = (),
    singles: Sequence[Sequence[str]] = (),
) -> dict[str, int]:
    """Repetitions above the degrees that all pairs and triples allow, with the least sum.

    With e >= 0 repetitions more, e_first = 0 implies e_second >= second_more if and only if
    second_more e_first + e_second >= second_more; and a triple says e_first + 2 e_second + 2 e_third >= 2
    where e_first = 0 is excluded by pairs. Of three that cannot be `singles`, one is repeated.
    """
    if not (pairs or singles):
        return dict.fromkeys(names, 0)
    conditions: list[_Condition] = []
    for first, second, first_more, second_more, shared, _ in pairs:
        conditions.append(({first: second_more, second: 1}, second_more))
        conditions.append(({first: 1, second: first_more}, first_more))
        conditions += [({first: y, second: x}, h) for y, x, h in shared]
    conditions += [({first: 1, second: 2, third: 2}, 2) for first, second, third, _ in triples]
    conditions += [(dict.fromkeys(three, 1), 1) for three in singles]
    return dict.fromkeys(names, 0) | _least_sum(conditions)


def _least_sum(conditions: Sequence[_Condition]) -> dict[str, int]:
    """Whole numbers >= 0 with the least sum for which sum factor e >= least > 0 in all conditions.

    Sums are tried one after the other; only where this takes long there is an integer program, as it is
    slow to import.
    """
    nodes = count()
    try:
        return next(filter(None, (_of_sum(conditions, {}, frozenset(), n, nodes) for n in count(1))))
    except _ManyError:
        pass
    from scipy.optimize import LinearConstraint, milp  # here because it is slow to import

    names = sorted({name for factors, _ in conditions for name in factors})
    rows = np.array([[factors.get(name, 0) for name in names] for factors, _ in conditions])
    ones, least = np.ones(len(names)), [least for _, least in conditions]
    program = milp(ones, constraints=LinearConstraint(rows, lb=least), integrality=ones)
    return {name: round(float(e)) for name, e in zip(names, program.x, strict=True)}


class _ManyError(Exception):
    """More attempts than an integer program is worth."""


def _of_sum(
    conditions: Sequence[_Condition],
    e: Mapping[str, int],
    settled: frozenset[str],
    left: int,
    nodes: Iterator[int],
) -> dict[str, int] | None:
    """Numbers from `e` on, increased by so much at most, that meet all conditions; or None.

    Some condition is not met: one of its numbers that are not `settled` is larger, and where none of
    those before it is, these are settled. Conditions without a common number need an increase each.
    """
    if next(nodes) > _MOST_TRIED:
        raise _ManyError
    open_ = []
    for factors, least in conditions:
        lacking = least - sum(factor * e.get(name, 0) for name, factor in factors.items())
        if lacking > 0:
            free = {name: factor for name, factor in factors.items() if name not in settled}
            if not free:
                return None
            open_.append((free, -(-lacking // max(free.values()))))
    open_.sort(key=lambda condition: len(condition[0]))
    needed, used = 0, set[str]()
    for free, increase in open_:
        if used.isdisjoint(free):
            needed, used = needed + increase, used.union(free)
    if needed > left:
        return None
    if not open_:
        return dict(e)
    for name in open_[0][0]:
        met = _of_sum(conditions, {**e, name: e.get(name, 0) + 1}, settled, left - 1, nodes)
        if met is not None:
            return met
        settled |= {name}
    return None


def excluding(more: Mapping[str, int], pairs: Sequence[Pair]) -> Iterator[Triple]:
    """Triples that would exclude these repetitions above the degrees, of deltas that are in pairs."""
    beside: dict[tuple[str, bool], list[str]] = {}
    for pair in pairs:
        beside.setdefault((pair.first, pair.is_transposed), []).append(pair.second)
        beside.setdefault((pair.second, pair.is_transposed), []).append(pair.first)
    for (first, is_transposed), others in beside.items():
        for second, third in combinations(others, 2):
            triple = Triple(first, second, third, is_transposed)
            if more[triple.first] <= 1 and more[triple.second] == more[triple.third] == 0:
                yield triple
