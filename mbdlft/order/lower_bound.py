"""Lower bounds on the order of an LFT, proved on residues modulo a prime: degrees, pairs and triples.

*Degrees.* Fix all deltas but one at random residues. What is left is H(0) + z C (I - z A)^-1 B, and every
exact LFT of the same matrix repeats that delta at least as often as the McMillan degree of H, the number
of states that are reachable and observable. A rank modulo a prime, at special values of the others, is
not above the true one, so the bound is proved. (The residues are those of the homomorphism in
`mbdlft.exact.numbers`; two numbers that differ have one residue with a probability of about 1e-18.)

*Pairs.* Fix all deltas but a and b. What is left is H(a, b) with n_in columns, of McMillan degrees D_a
and D_b. The pairs (u, y) of polynomials with y = H u are a vector bundle G on the product of two
projective lines. From an LFT with D_a and D_b repetitions follows X = H^1(G(-1, -1)) = 0. So if
h = dim X > 0 there is none: if a has D_a repetitions, b has at least D_b + h/kappa, where on every line
b = const the pairs are generated in degree kappa of a at most.

*Triples.* One repetition of a more than D_a is a line bundle on a plane a = const. If X_ab has an element
that is constant in c, and X_ac is not zero, it cannot be enough for both b and c to have their degree.

*How X is computed.* For a value alpha of a, and polynomials u in the other deltas such that
y = H(alpha, .) u is a polynomial of the same degrees, f = (H u - y)/(a - alpha) is a section of the sheaf
of the columns of [H I]. Those of k values alpha span a space E. With b alone and u of a degree below
l = D_b + 2, E is complete when it does not grow with the next value, and then k is at least kappa.
X_j = H^1(G(-1, -j)) are the f with f and b^(l+j-1) f in E. Functions are known by their values at random
residues, polynomials are found by interpolation, and ranks are exact.

Theorems and proofs: docs/method.md, section "Pairs that cannot both be smallest".
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import combinations, product, takewhile
from math import ceil, prod
from typing import NamedTuple

import numpy as np

from mbdlft.exact.matrices import (
    Residues,
    multiplied,
    null_space,
    rank,
    reduced_residues,
    row_echelon,
    solved,
)
from mbdlft.order.reduction import ExactLFT
from mbdlft.order.work import Work, exact_elimination, exact_solutions

_EXTRA = 2  # samples more than needed
_SURPLUS = 4  # dimensions of E above degree times coefficients, at first: h is rarely larger
_MOST_COEFFICIENTS = {1: 300, 2: 200}  # of u in so many deltas: more take many seconds, and are left open


class Pair(NamedTuple):
    """Two deltas that do not both have their degree.

    `second_more` are the repetitions above its degree that the second needs if the first has none, and
    the other way round. Both are at least 1. `is_transposed` says whether it is proved for H or for its
    transpose.
    """

    first: str
    second: str
    first_more: int
    second_more: int
    is_transposed: bool = False


class Triple(NamedTuple):
    """If the last two deltas have their degree, the first has at least two repetitions above its own."""

    first: str
    second: str
    third: str
    is_transposed: bool = False


def exact_degrees(a: ExactLFT, seed: int = 0) -> dict[str, int]:
    """Proved minimum of the repetitions of each delta, in any exact LFT of the same matrix."""
    M, n = at_random(a, seed), a.order
    degrees = {}
    for block, rows in zip(a.blocks, a.parts, strict=True):
        channels = np.arange(rows.start, rows.stop)
        degrees[block.name] = sum(
            reduced_residues(_restricted(M, channels, n), [block.size], a.M.prime)[1]
        )
    return degrees


@lru_cache(maxsize=1)  # pairs and triples of the same LFT are asked for one after the other
def at_random(a: ExactLFT, seed: int = 0) -> Residues:
    """[M11 M12 ; M21 M22] in the distances of the deltas from random residues.

    With w' = (Delta - D) z, z = M11 (w' + D z) + M12 u. What belongs to some of the deltas is the LFT in
    these, the others at their values. That of the transposed LFT is the transpose.
    """
    random, M, n, prime = np.random.default_rng(seed), a.M.residues, a.order, a.M.prime
    at = random.integers(1, prime, len(a.blocks), dtype=np.int64)
    values = np.repeat(at, [block.size for block in a.blocks]).astype(object)
    loop = np.asarray((np.eye(n, dtype=object) - M[:n, :n] * values) % prime, dtype=np.int64)
    z = solved(loop, M[:n], prime)
    outside = np.asarray(M[n:, :n] * values % prime, dtype=np.int64)
    shifted = np.vstack([z, (M[n:] + multiplied(outside, z, prime)) % prime])
    shifted.setflags(write=False)
    return shifted


def _restricted(M: Residues, channels: Residues, n: int) -> Residues:
    """The rows and columns of some of n channels, and of the signals."""
    return np.asarray(M[np.ix_(np.r_[channels, n : M.shape[0]], np.r_[channels, n : M.shape[1]])])


class JointBound:
    """The bound by pairs and triples of deltas of one LFT, each once; residues are enough."""

    def __init__(self, a: ExactLFT, degrees: Mapping[str, int]) -> None:
        self.a, self.degrees = a, degrees
        self._pairs: dict[tuple[str, str, bool], Pair | None] = {}
        self._triples: dict[Triple, bool] = {}

    def pairs(self, first: str, second: str, work: Work) -> list[Pair]:
        """What is proved for two deltas, for H and for its transpose, until the work is over."""
        proved = []
        for side in (False, True):
            key = (first, second, side)
            if key not in self._pairs and not work.is_over:
                more = more_needed(self.a, first, second, self.degrees, work, is_transposed=side)
                if all(more):
                    self._pairs[key] = Pair(first, second, *more, side)
                elif not work.is_over:  # it was looked at to the end
                    self._pairs[key] = None
            proved.append(self._pairs.get(key))
        return [pair for pair in proved if pair is not None]

    def of_all(self, work: Work) -> int:
        """Proved minimum of the order of any LFT of the matrix, by pairs and triples as work allows."""
        for first, second in combinations([name for name, n in self.degrees.items() if n], 2):
            self.pairs(first, second, work)
        while True:
            # only a triple that the repetitions contradict can raise the bound
            open_ = [t for t in _excluding(self._more(), self._proved()) if t not in self._triples]
            if not open_ or work.is_over:
                return self.known
            for triple in open_:
                self._triples[triple] = not work.is_over and self._is_proved(triple, work)

    @property
    def known(self) -> int:
        """The bound by the pairs and triples that were looked at."""
        return sum(self.degrees.values()) + sum(self._more().values())

    def _proved(self) -> list[Pair]:
        return [pair for pair in self._pairs.values() if pair is not None]

    def _more(self) -> dict[str, int]:
        triples = [triple for triple, is_proved in self._triples.items() if is_proved]
        return least_more(list(self.degrees), self._proved(), triples)

    def _is_proved(self, triple: Triple, work: Work) -> bool:
        first, second, third, is_transposed = triple
        return any(
            is_constant(self.a, names, self.degrees, work, is_transposed=is_transposed)
            for names in ((first, second, third), (first, third, second))
        )


def least_more(
    names: Sequence[str], pairs: Sequence[Pair], triples: Sequence[Triple] = ()
) -> dict[str, int]:
    """Repetitions above the degrees that all pairs and triples allow, with the least sum.

    With e >= 0 repetitions more, e_first = 0 implies e_second >= second_more if and only if
    second_more e_first + e_second >= second_more; and a triple says e_first + 2 e_second + 2 e_third >= 2
    where e_first = 0 is excluded by pairs.
    """
    if not pairs:
        return dict.fromkeys(names, 0)
    from scipy.optimize import LinearConstraint, milp  # here because it is slow to import

    conditions: list[tuple[dict[str, int], int]] = []
    for first, second, first_more, second_more, _ in pairs:
        conditions.append(({first: second_more, second: 1}, second_more))
        conditions.append(({first: 1, second: first_more}, first_more))
    conditions += [({first: 1, second: 2, third: 2}, 2) for first, second, third, _ in triples]
    rows = np.array([[factors.get(name, 0) for name in names] for factors, _ in conditions])
    least = np.array([least for _, least in conditions])
    ones = np.ones(len(names))
    program = milp(ones, constraints=LinearConstraint(rows, lb=least), integrality=ones)
    return {name: round(float(e)) for name, e in zip(names, program.x, strict=True)}


def allows(pair: Pair, more: Mapping[str, int]) -> bool:
    """Whether a pair leaves these repetitions above the degrees possible."""
    first, second = more[pair.first], more[pair.second]
    return (first > 0 or second >= pair.second_more) and (second > 0 or first >= pair.first_more)


def _excludes(triple: Triple, more: Mapping[str, int]) -> bool:
    """Whether these repetitions above the degrees are not possible."""
    return more[triple.first] <= 1 and more[triple.second] == more[triple.third] == 0


def _excluding(more: Mapping[str, int], pairs: Sequence[Pair]) -> Iterator[Triple]:
    """Triples that would exclude these repetitions above the degrees, of deltas that are in pairs."""
    beside: dict[tuple[str, bool], list[str]] = {}
    for pair in pairs:
        beside.setdefault((pair.first, pair.is_transposed), []).append(pair.second)
        beside.setdefault((pair.second, pair.is_transposed), []).append(pair.first)
    for (first, is_transposed), others in beside.items():
        for second, third in combinations(others, 2):
            triple = Triple(first, second, third, is_transposed)
            if _excludes(triple, more):
                yield triple


class _Function(NamedTuple):
    """H in a few deltas: [A B ; C 0] as residues, its blocks by name, inputs and outputs that matter."""

    M: Residues
    parts: Mapping[str, slice]
    prime: int
    work: Work

    @property
    def order(self) -> int:
        return max((part.stop for part in self.parts.values()), default=0)

    @property
    def shape(self) -> tuple[int, int]:
        """Outputs and inputs."""
        return self.M.shape[0] - self.order, self.M.shape[1] - self.order

    def at(self, points: Sequence[Mapping[str, int]]) -> Residues:
        """Values (N, outputs, inputs), without the constant part."""
        n, p, values = self.order, self.shape[0], []
        self.work.add(exact_solutions(len(points), n + self.shape[1]))
        M, identity = self.M[:, :n].astype(object), np.eye(n, dtype=object)
        sizes = [part.stop - part.start for part in self.parts.values()]
        B = self.M[:n, n:]
        for point in points:
            delta = np.repeat([point[name] for name in self.parts], sizes)
            columns = M * delta.astype(object)
            loop = np.asarray((identity - columns[:n]) % self.prime, dtype=np.int64)
            C = np.asarray(columns[n:] % self.prime, dtype=np.int64)
            values.append(multiplied(C, solved(loop, B, self.prime), self.prime))
        return np.array(values, dtype=np.int64).reshape(len(points), p, -1)


class _Span(NamedTuple):
    """E: independent columns (samples, dimension), the points of the samples, k values alpha."""

    columns: Residues
    points: Sequence[Mapping[str, int]]
    k: int


def more_needed(
    a: ExactLFT, first: str, second: str, degrees: Mapping[str, int], work: Work, *, is_transposed: bool
) -> tuple[int, int]:
    """Repetitions that each of two deltas needs above its degree if the other has none; (0, 0): open."""
    if work.is_over:
        return 0, 0
    H = _function(a, (first, second), work, is_transposed=is_transposed)
    if H.order == degrees[first] + degrees[second] or H.shape[1] <= 1:
        return 0, 0
    first_more = _more(H, second, first, degrees)
    return (first_more, _more(H, first, second, degrees)) if first_more else (0, 0)


def is_constant(
    a: ExactLFT,
    names: tuple[str, str, str],
    degrees: Mapping[str, int],
    work: Work,
    *,
    is_transposed: bool,
) -> bool:
    """Whether an obstruction of the first two deltas is found that is constant in the third."""
    if work.is_over:
        return False
    first, second, third = names
    H = _function(a, names, work, is_transposed=is_transposed)
    power = degrees[second] + 2
    E = _span(H, first, {second: power, third: 2}, degrees, 3)
    if E is None:
        return False
    return _inside(E, H.prime, {second: power}, {third: 1}, {second: power, third: 1}) > 0


def _function(a: ExactLFT, names: Sequence[str], work: Work, *, is_transposed: bool) -> _Function:
    kept = [(b, part) for b, part in zip(a.blocks, a.parts, strict=True) if b.name in names]
    channels = np.concatenate([np.arange(part.start, part.stop) for _, part in kept])
    prime = a.M.prime
    M = at_random(a).T if is_transposed else at_random(a)
    M, counts = reduced_residues(_restricted(M, channels, a.order), [b.size for b, _ in kept], prime)
    n = sum(counts)
    # inputs and outputs that are combinations of others do not matter
    _, columns = row_echelon(M[:n, n:], prime)
    _, rows = row_echelon(np.ascontiguousarray(M[n:, :n].T), prime)
    M = M[np.ix_([*range(n), *(n + k for k in rows)], [*range(n), *(n + k for k in columns)])]
    ends = np.cumsum([0, *counts]).tolist()
    parts = {b.name: slice(s, e) for (b, _), s, e in zip(kept, ends[:-1], ends[1:], strict=True)}
    return _Function(M, parts, prime, work)


def _more(H: _Function, first: str, second: str, degrees: Mapping[str, int]) -> int:
    """Repetitions of the second delta above its degree if the first has none: h_j/kappa + j - 1."""
    length = degrees[second] + 2
    E = _span(H, first, {second: length}, degrees, 1)
    if E is None or E.columns.shape[1] - _inside(E, H.prime, {second: 1}) != degrees[first]:
        return 0
    dimensions = takewhile(bool, (_inside(E, H.prime, {second: length + j}) for j in range(_EXTRA + 1)))
    return max((ceil(h / E.k) + before for before, h in enumerate(dimensions)), default=0)


def _span(
    H: _Function,
    first: str,
    lengths: Mapping[str, int],
    degrees: Mapping[str, int],
    moves: int,
    count: int = 0,
) -> _Span | None:
    """E of the polynomials u with so many powers of each delta but the first, known at random points.

    There are as many points as E and its products with so many monomials can have dimensions, so that
    independent functions have independent values. None if E is too large, or the work is over.
    """
    (p, q), prime = H.shape, H.prime
    coefficients = prod(lengths.values())
    if q * coefficients > _MOST_COEFFICIENTS[len(lengths)]:
        return None
    random = np.random.default_rng(1)

    def draw(*shape: int) -> Residues:
        return random.integers(1, prime, shape, dtype=np.int64)

    # a polynomial of as many powers that has the values of H u on this grid is H u
    axes = {name: draw(n + degrees[name] + _EXTRA).tolist() for name, n in lengths.items()}
    grid = [dict(zip(axes, at, strict=True)) for at in product(*axes.values())]
    monomials = _monomials(grid, lengths, prime)
    high, low = _modes(axes, lengths, prime)
    count = count or (1 + moves) * (degrees[first] * coefficients + _SURPLUS) + _EXTRA
    names = (first, *lengths)
    points = [dict(zip(names, at, strict=True)) for at in draw(count, len(names)).tolist()]
    directions, powers = draw(count, p), _monomials(points, lengths, prime)
    all_Hu = _times(_seen(H.at(points), directions, prime), powers, prime)
    all_y = _times(directions, powers, prime)
    E = np.zeros((count, 0), dtype=np.int64)
    for k, alpha in enumerate(draw(2 * degrees[first] + 2).tolist()):
        if H.work.is_over:
            return None
        value = H.at([{first: alpha, **at} for at in grid])
        # H u at the grid by entries of y: (grid, p, coefficients of u)
        Hu = np.hstack([_times(value[:, i], monomials, prime) for i in range(p)])
        H.work.add(exact_elimination(p * len(high), q * coefficients))
        u = null_space(multiplied(high, Hu, prime).reshape(-1, q * coefficients), prime)
        y = multiplied(multiplied(low, Hu, prime).reshape(-1, q * coefficients), u, prime)
        y = y.reshape(len(low), p, -1).swapaxes(0, 1).reshape(p * len(low), -1)
        sections = (multiplied(all_Hu, u, prime) - multiplied(all_y, y, prime)) % prime
        over = [pow(point[first] - alpha, -1, prime) for point in points]
        both = np.hstack([E, _scaled(over, sections, prime)])
        H.work.add(exact_elimination(*both.shape))
        _, pivots = row_echelon(both, prime)
        if len(pivots) == E.shape[1]:
            needed = (1 + moves) * len(pivots) + _EXTRA
            if needed > count:
                return _span(H, first, lengths, degrees, moves, needed)
            return _Span(E, points, k)
        E = both[:, pivots]
    return None


def _inside(E: _Span, prime: int, *moves: Mapping[str, int]) -> int:
    """Dimension of the functions f in E whose products with all monomials of `moves` are in it, too."""
    size, zero = E.columns.shape[1], np.zeros_like(E.columns)
    rows = []
    for k, move in enumerate(moves):
        factors = [
            int(prod(pow(point[name], power, prime) for name, power in move.items())) % prime
            for point in E.points
        ]
        moved = [E.columns if j == k else zero for j in range(len(moves))]
        rows.append(np.hstack([_scaled(factors, E.columns, prime), *moved]))
    return int(size * (1 + len(moves)) - rank(np.vstack(rows), prime))


def _monomials(points: Sequence[Mapping[str, int]], lengths: Mapping[str, int], prime: int) -> Residues:
    """Values (points, coefficients) of the products of powers below `lengths`."""
    powers = list(product(*(range(n) for n in lengths.values())))
    return np.array(
        [
            [
                prod(pow(at[name], k, prime) for name, k in zip(lengths, exponents, strict=True)) % prime
                for exponents in powers
            ]
            for at in points
        ],
        dtype=np.int64,
    )


def _interpolation(axes: Mapping[str, list[int]], prime: int) -> Residues:
    """Values on a grid to coefficients of polynomials."""
    inverses = np.ones((1, 1), dtype=np.int64)
    for nodes in axes.values():
        vandermonde = np.array(
            [[pow(x, k, prime) for k in range(len(nodes))] for x in nodes], dtype=np.int64
        )
        inverse = solved(vandermonde, np.eye(len(nodes), dtype=np.int64), prime)
        inverses = _kronecker(inverses, inverse, prime)
    return inverses


def _kronecker(a: Residues, b: Residues, prime: int) -> Residues:
    outer = multiplied(a.reshape(-1, 1), b.reshape(1, -1), prime)
    blocks = outer.reshape(*a.shape, *b.shape).swapaxes(1, 2)
    return np.asarray(blocks.reshape(len(a) * len(b), -1))


def _modes(
    axes: Mapping[str, list[int]], lengths: Mapping[str, int], prime: int
) -> tuple[Residues, Residues]:
    """From values on the grid to coefficients beyond the degrees of u, zero for it; to the others."""
    places = product(*(range(len(nodes)) for nodes in axes.values()))
    below = [all(k < n for k, n in zip(exponents, lengths.values(), strict=True)) for exponents in places]
    is_low, all_modes = np.array(below), _interpolation(axes, prime)
    return all_modes[~is_low], all_modes[is_low]


def _seen(values: Residues, directions: Residues, prime: int) -> Residues:
    """left' values (N, inputs) for values (N, outputs, inputs)."""
    products = directions.astype(object)[:, :, None] * values.astype(object)
    return np.asarray(np.sum(products, axis=1) % prime, dtype=np.int64)


def _times(entries: Residues, powers: Residues, prime: int) -> Residues:
    """Products (N, m n) of entries (N, m) and powers (N, n)."""
    products = entries.astype(object)[:, :, None] * powers.astype(object)[:, None, :]
    return np.asarray(products % prime, dtype=np.int64).reshape(len(entries), -1)


def _scaled(factors: Sequence[int], rows: Residues, prime: int) -> Residues:
    """Rows times their factors."""
    products = np.array(factors, dtype=object)[:, None] * rows.astype(object)
    return np.asarray(products % prime, dtype=np.int64)
