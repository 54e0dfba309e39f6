"""Lower bounds on the order of an LFT, proved on residues modulo a prime: degrees, pairs and triples.

*Degrees.* Fix all deltas but one at random residues. What is left is H(0) + z C (I - z A)^-1 B, and every
exact LFT of the same matrix repeats that delta at least as often as the McMillan degree of H, the number
of states that are reachable and observable. A rank modulo a prime, at special values of the others, is
not above the true one, so the bound is proved. (The residues are those of the homomorphism in
`mbdlft.exact.numbers`; two numbers that differ have one residue with a probability of about 1e-18.)

*Pairs.* Fix all deltas but a and b. What is left is H(a, b) with n_in columns, of McMillan degrees D_a
and D_b. The pairs (u, y) of polynomials with y = H u are a vector bundle G on the product of two
projective lines. From an LFT with D_a and D_b repetitions follows X = H^1(G(-1, -1)) = 0. So if
h = dim X > 0 there is none. Let X_xy be the part of X whose products with x linear functions of a and y
of b vanish in H^1(G(x - 1, y - 1)). For repetitions e above the degrees, dim X_xy <= x e_b + y e_a.

*Triples.* One repetition of a more than D_a is a line bundle on a plane a = const. If X_ab has an element
that is constant in c, and X_ac is not zero, it cannot be enough for both b and c to have their degree.

*How X is computed.* For a value alpha of a, and polynomials u in the other deltas such that
y = H(alpha, .) u is a polynomial of the same degrees, f = (H u - y)/(a - alpha) is a section of the sheaf
of the columns of [H I]. Those of k values alpha span a space E. With b alone and u of a degree below
l = D_b + 2, E is complete when it does not grow with the next value.
X_j = H^1(G(-1, -j)) are the f with f and b^(l+j-1) f in E. In b alone H(alpha, .) is
D + b C (I - b A)^-1 B, and y is a polynomial of a degree below l if and only if

    A^(l-1) B u_0 + ... + A B u_(l-2) + B u_(l-1)

is not observable. Polynomials in a third delta are found by interpolation; functions are known by their
values at random residues, and ranks are exact.

*Affine triples.* If H is affine in each of three deltas, an LFT that has each of them once has a constant
determinant I - M11 Delta: H times it has no higher degrees than H. So no channel feeds itself back,
the three stand in an order, and the slope of H in the middle one, y, is g(z) h(x) with a column g and a
row h: its values at two z and two x are blocks of a matrix of rank 1. Where no delta can be the middle
one, one of the three is repeated. (All products of two of three variables: order 4, degrees 1, 1, 1.)

Theorems and proofs: docs/pairs.md.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import permutations
from math import ceil
from typing import NamedTuple

import numpy as np

from mbdlft.exact.modular import (
    Residues,
    entrywise,
    inverses,
    multiplied,
    null_space,
    pivot_columns,
    powers_of,
    rank,
    reachable_bases,
    reduced_residues,
    reduced_sizes,
    resolvents,
    row_echelon,
    solved,
)
from mbdlft.order.reduction import ExactLFT
from mbdlft.order.work import Work, exact_elimination, exact_resolvents, exact_solutions

_EXTRA = 2  # samples more than needed
_SURPLUS = 12  # dimensions of E above degree times coefficients, at first: h is rarely larger
_OPEN = (0, 0, ())
_LINE = 20_261_127  # where no line b = const is special
_ROOM = 4  # times the points that were too few: as many more at once
_REDUCED = 5e6  # operations of an LFT in a few deltas: some half a millisecond with the call
_MOST_COEFFICIENTS = {1: 600, 2: 200}  # of u in so many deltas: more take many seconds, and are left open


def exact_degrees(a: ExactLFT, seed: int = 0) -> dict[str, int]:
    """Proved minimum of the repetitions of each delta, in any exact LFT of the same matrix."""
    M, n, degrees = at_random(a, seed), a.order, dict[str, int]()
    for block, rows in zip(a.blocks, a.parts, strict=True):
        alone = _restricted(M, np.arange(rows.start, rows.stop), n)
        (degrees[block.name],) = reduced_sizes(alone, [block.size], a.M.prime)
    return degrees


def is_affine(a: ExactLFT, name: str) -> bool:
    """Whether the value is affine in a delta of degree 1."""
    ((block, rows),) = [pair for pair in zip(a.blocks, a.parts, strict=True) if pair[0].name == name]
    M = _restricted(at_random(a, 0), np.arange(rows.start, rows.stop), a.order)
    M, (size,) = reduced_residues(M, [block.size], a.M.prime)
    return not M[:size, :size].any()


@lru_cache(maxsize=1)  # pairs and triples of the same LFT are asked for one after the other
def at_random(a: ExactLFT, seed: int = 0) -> Residues:
    """[M11 M12 ; M21 M22] in the distances of the deltas from random residues.

    With w' = (Delta - D) z, z = M11 (w' + D z) + M12 u. What belongs to some of the deltas is the LFT in
    these, the others at their values. That of the transposed LFT is the transpose.
    """
    random, M, n, prime = np.random.default_rng(seed), a.M.residues, a.order, a.M.prime
    at = random.integers(1, prime, len(a.blocks), dtype=np.int64)
    moved = entrywise(M[:, :n], np.repeat(at, [block.size for block in a.blocks]), prime)
    z = solved((np.eye(n, dtype=np.int64) - moved[:n]) % prime, M[:n], prime)
    shifted = np.vstack([z, (M[n:] + multiplied(moved[n:], z, prime)) % prime])
    shifted.setflags(write=False)
    return shifted


def _restricted(M: Residues, channels: Residues, n: int) -> Residues:
    """The rows and columns of some of n channels, and of the signals."""
    return np.asarray(M[np.ix_(np.r_[channels, n : M.shape[0]], np.r_[channels, n : M.shape[1]])])


Shared = tuple[int, int, int]  # y, x, h: y e_first + x e_second >= h


class _Function(NamedTuple):
    """H in a few deltas: [A B ; C 0] as residues, its blocks by name, inputs and outputs that matter."""

    M: Residues
    slices: Mapping[str, slice]
    prime: int
    work: Work

    @property
    def order(self) -> int:
        return max((span.stop for span in self.slices.values()), default=0)

    @property
    def shape(self) -> tuple[int, int]:
        """Outputs and inputs."""
        return self.M.shape[0] - self.order, self.M.shape[1] - self.order

    def surplus(self, degrees: Mapping[str, int]) -> int:
        """Seldom less than h: of two deltas, repetitions above a degree times the other degree."""
        above = {name: span.stop - span.start - degrees[name] for name, span in self.slices.items()}
        return sum(degrees[a] * above[b] for a in above for b in above if a != b)

    def seen(self, points: Mapping[str, Residues], directions: Residues) -> Residues:
        """left' H (N, inputs) at N points for left sides (N, outputs); H without its constant part."""
        n, prime, count = self.order, self.prime, len(directions)
        self.work.add(exact_resolvents(count, n))
        sizes = [span.stop - span.start for span in self.slices.values()]
        diagonals = np.array([inverses(points[name], prime) for name in self.slices]).T
        right = multiplied(directions, self.M[n:, :n], prime)
        states = resolvents(self.M[:n, :n].T, np.repeat(diagonals, sizes, axis=1), right, prime)
        return multiplied(states, self.M[:n, n:], prime)

    def alone(self, name: str, at: Mapping[str, Residues]) -> Residues:
        """[A B ; C D] of one delta, the others at N values: D + delta C (I - delta A)^-1 B, (N, ., .)."""
        n, prime, kept = self.order, self.prime, range(self.order)[self.slices[name]]
        fixed = [span for other, span in self.slices.items() if other != name]
        channels = np.concatenate([np.arange(span.start, span.stop) for span in fixed])
        sizes = [span.stop - span.start for span in fixed]
        deltas = np.repeat(
            np.array([at[other] for other in self.slices if other != name]), sizes, axis=0
        ).T
        rows, columns = [*kept, *range(n, len(self.M))], [*kept, *range(n, self.M.shape[1])]
        self.work.add(exact_solutions(len(deltas), len(channels) + len(columns)))
        inner = entrywise(self.M[:, channels], deltas[:, None], prime)
        loops = (np.eye(len(channels), dtype=np.int64) - inner[:, channels]) % prime
        right = self.M[np.ix_(channels, columns)]
        inside = np.array([solved(loop, right, prime) for loop in loops])
        through = multiplied(inner[:, rows], inside, prime)
        return np.asarray((self.M[np.ix_(rows, columns)] + through) % prime)


class _Span(NamedTuple):
    """E: its echelon form (dimension, samples), pivots, what each value alpha adds, with its pivots."""

    rows: Residues
    pivots: Sequence[int]
    added: Sequence[tuple[Residues, Sequence[int]]]
    samples: "_Samples"


class _Samples(NamedTuple):
    """Points, left sides, and left' H there."""

    points: Mapping[str, Residues]
    directions: Residues
    seen: Residues


def more_needed(
    a: ExactLFT, first: str, second: str, degrees: Mapping[str, int], work: Work, *, is_transposed: bool
) -> tuple[int, int, tuple[Shared, ...]]:
    """Repetitions e that each of two deltas needs above its degree if the other has none, and y, x, h
    with y e_first + x e_second >= h where one of each is not enough for that; zeros: open."""
    if work.is_over:
        return _OPEN
    H = _function(a, (first, second), work, is_transposed=is_transposed)
    if H.order == degrees[first] + degrees[second] or H.shape[1] <= 1:
        return _OPEN
    if degrees[second] <= degrees[first]:  # fewer powers cost less
        return _both_more(H, first, second, degrees)
    of_second, of_first, shared = _both_more(H, second, first, degrees)
    return of_first, of_second, tuple((x, y, h) for y, x, h in shared)


def is_constant(
    a: ExactLFT, names: Sequence[str], degrees: Mapping[str, int], work: Work, *, is_transposed: bool
) -> bool:
    """Whether an obstruction of the first two deltas is found that is constant in the third."""
    if work.is_over:
        return False
    first, second, third = names
    H = _function(a, names, work, is_transposed=is_transposed)
    power = degrees[second] + 2
    E = _span(H, first, {second: power, third: 2}, degrees, 3)
    moves = {second: power}, {third: 1}, {second: power, third: 1}
    return E is not None and _inside(E, H.prime, *moves) > 0


def _function(a: ExactLFT, names: Sequence[str], work: Work, *, is_transposed: bool) -> _Function:
    M, slices = _reduced(a, tuple(names))
    work.add(_REDUCED)
    return _Function(M.T if is_transposed else M, slices, a.M.prime, work)


@lru_cache(maxsize=1)  # H and its transpose are asked for one after the other
def _reduced(a: ExactLFT, names: tuple[str, ...]) -> tuple[Residues, Mapping[str, slice]]:
    """[A B ; C 0] of H in a few deltas, reduced, and its blocks; the transpose has its transpose."""
    kept = [(b, span) for b, span in zip(a.blocks, a.parts, strict=True) if b.name in names]
    channels = np.concatenate([np.arange(span.start, span.stop) for _, span in kept])
    M, prime = _restricted(at_random(a), channels, a.order), a.M.prime
    M, counts = reduced_residues(M, [b.size for b, _ in kept], prime)
    n = sum(counts)
    # inputs and outputs that are combinations of others do not matter
    columns, rows = pivot_columns(M[:n, n:], prime), pivot_columns(M[n:, :n].T, prime)
    M = M[np.ix_([*range(n), *(n + k for k in rows)], [*range(n), *(n + k for k in columns)])]
    M[n:, n:] = 0  # the constant part
    ends = np.cumsum([0, *counts]).tolist()
    return M, {b.name: slice(s, e) for (b, _), s, e in zip(kept, ends[:-1], ends[1:], strict=True)}


class _More(NamedTuple):
    """Repetitions of the second delta above its degree if the first has none; E, X (h, samples), and the
    dimensions of X_xy for x = 1, 2, ... linear functions of the first and many of the second."""

    more: int
    E: _Span
    X: Residues
    vanishing: Sequence[int]


def _both_more(
    H: _Function, first: str, second: str, degrees: Mapping[str, int]
) -> tuple[int, int, tuple[Shared, ...]]:
    """`more_needed`, by one side if the other is too large: the second has not the larger degree."""
    of_second = _more(H, first, second, degrees)
    if of_second is None:
        return _OPEN
    of_first = _more(H, second, first, degrees)
    if of_first is None:
        shared = _shared(H, first, second, degrees, of_second, ())
        more = max((ceil(h / y) for y, _, h in shared), default=1)
    elif len(of_first.vanishing) <= len(of_second.vanishing):
        shared, more = _shared(H, first, second, degrees, of_second, of_first.vanishing), of_first.more
    else:
        turned = _shared(H, second, first, degrees, of_first, of_second.vanishing)
        shared, more = [(x, y, h) for y, x, h in turned], of_first.more
    return more, of_second.more, tuple((y, x, h) for y, x, h in shared if h > x + y)


def _more(H: _Function, first: str, second: str, degrees: Mapping[str, int]) -> _More | None:
    """What the second delta needs if the first has its degree: h_jx/x + j - 1; None: nothing."""
    length, prime = degrees[second] + 1, H.prime
    E = _span(H, first, {second: length}, degrees, 1)
    if E is None:
        return None
    lines, found = (E.samples.points[second] + _LINE) % prime, list[tuple[Residues, list[int]]]()
    for j in range(_EXTRA + 1):
        coefficients = null_space(_left(E, prime, {second: length + j}).T, prime).T
        if not len(coefficients):
            break
        X = multiplied(coefficients, E.rows, prime)
        moved = entrywise(X, powers_of(lines, length + j + 1, prime)[:, -1], prime)
        found.append((X, _vanishing(H, E, moved)))
    if not found or len(E.rows) - _inside(E, prime, {second: 1}) != degrees[first]:
        return None
    more = (ceil(h / x) + j for j, (_, dims) in enumerate(found) for x, h in enumerate(dims, 1) if h)
    return _More(max(more), E, *found[0])


def _vanishing(H: _Function, E: _Span, X: Residues) -> list[int]:
    """Dimensions of what of X is among the sections of 1, 2, ... values, until it is all of it."""
    dimensions = list[int]()
    for fresh, pivots in E.added:
        X = (X - multiplied(X[:, pivots], fresh, H.prime)) % H.prime
        H.work.add(exact_elimination(*X.shape))
        dimensions.append(len(X) - rank(X, H.prime))
        if dimensions[-1] == len(X):
            break
    return dimensions


def _shared(
    H: _Function, first: str, second: str, degrees: Mapping[str, int], found: _More, beside: Sequence[int]
) -> list[Shared]:
    """y, x, h with h <= y e_first + x e_second for all repetitions above the degrees.

    h are the dimensions of what of X, with y linear functions of the second delta, is among the sections
    of x values of the first one that have y powers. With `beside`, what they are for y = 1, 2, ... and
    many for x, what one of each is enough for is left out.
    """
    E, X, shared = found.E, found.X, list[Shared]()
    factors = (E.samples.points[second] + _LINE) % H.prime
    for y in range(1, degrees[second] + 1):
        X = entrywise(X, factors, H.prime)
        most = beside[min(y, len(beside)) - 1] if beside else 0
        if beside and all(min(most, h) <= x + y for x, h in enumerate(found.vanishing, 1)):
            continue
        sections = _span(H, first, {second: y}, degrees, 0, E.samples)
        if sections is None:
            break
        dimensions = _vanishing(H, sections, X)
        for x, h in enumerate(dimensions, 1):
            if h and all(h > c or x < b or y < a for a, b, c in shared):
                shared.append((y, x, h))
        if dimensions == found.vanishing:  # as with many for y
            break
    return shared


def _span(
    H: _Function,
    first: str,
    lengths: Mapping[str, int],
    degrees: Mapping[str, int],
    moves: int,
    samples: _Samples | int = 0,
) -> _Span | None:
    """E of the polynomials u with so many powers of one delta, or of two, known at random points.

    There are as many points as E and its products with so many monomials can have dimensions, so that
    independent functions have independent values, or so many `samples`, or those of an E that is not
    smaller. None if E is too large, or the work is over.
    """
    prime, (second, *thirds) = H.prime, lengths
    length, wide = lengths[second], lengths[thirds[0]] if thirds else 1
    coefficients = length * wide
    if H.shape[1] * coefficients > _MOST_COEFFICIENTS[len(lengths)]:
        return None
    random = np.random.default_rng(2)
    # a polynomial of as many powers that has the values of H u at these nodes is H u
    nodes = random.integers(1, prime, wide + degrees[thirds[0]] + _EXTRA if thirds else 1)
    powers = powers_of(nodes, len(nodes), prime)
    modes = solved(powers, np.eye(len(nodes), dtype=np.int64), prime)
    if isinstance(samples, int):
        surplus = min(_SURPLUS, H.surplus(degrees)) if not thirds else _SURPLUS
        count = samples or (1 + moves) * (degrees[first] * coefficients + surplus) + _EXTRA
        if not H.work.has_room(exact_resolvents(count, H.order)):
            return None
        samples = _sampled(H, (first, *lengths), count)
    points, directions, seen = samples
    monomials = powers_of(points[second], length, prime)
    for third in thirds:
        monomials = _outer(monomials, powers_of(points[third], wide, prime), prime)
    sides = [_outer(x, monomials, prime) for x in (seen, -directions % prime)]
    at_samples = np.hstack(sides).T  # left' H u - left' y
    E: Residues = np.zeros((0, count := len(directions)), dtype=np.int64)
    pivots, added = list[int](), list[tuple[Residues, Sequence[int]]]()
    for alpha in random.integers(1, prime, 2 * degrees[first] + 2).tolist():
        if H.work.is_over:
            return None
        at = {first: np.full_like(nodes, alpha), **dict.fromkeys(thirds, nodes)}
        # random combinations of as many u as E can still grow by span the same
        most = None if thirds else count // (1 + moves) - len(E) + _EXTRA
        u, y = _polynomials(H, second, at, length, powers[:, :wide], modes, degrees[second], most)
        over = inverses((points[first] - alpha) % prime, prime)
        outside = entrywise(over, multiplied(np.vstack([u, y]).T, at_samples, prime), prime)
        outside = (outside - multiplied(outside[:, pivots], E, prime)) % prime
        H.work.add(exact_elimination(len(outside), count))
        fresh, more = row_echelon(outside, prime)
        if not more:
            needed = (1 + moves) * len(E) + _EXTRA
            if needed > count:  # E may be far larger than what there was room for
                return _span(H, first, lengths, degrees, moves, needed + _ROOM * (needed - count))
            return _Span(E, pivots, added, samples)
        E = np.vstack([(E - multiplied(E[:, more], fresh, prime)) % prime, fresh])
        pivots = [*pivots, *more]
        added.append((fresh, more))
    return None


def _sampled(H: _Function, names: Sequence[str], count: int) -> _Samples:
    random = np.random.default_rng(1)
    points = {name: random.integers(1, H.prime, count) for name in names}
    directions = random.integers(1, H.prime, (count, H.shape[0]))
    return _Samples(points, directions, H.seen(points, directions))


def _polynomials(
    H: _Function,
    second: str,
    at: Mapping[str, Residues],
    length: int,
    powers: Residues,
    modes: Residues,
    degree: int,
    most: int | None,
) -> tuple[Residues, Residues]:
    """Columns u (q, length, wide) and y = H u (p, length, wide) of all polynomials with so many powers.

    Of more than `most` there are that many random combinations. The others are `at` nodes of the third
    delta, with its `powers` there (nodes, wide); `modes` lead from values to coefficients.
    """
    (p, q), (count, wide), prime = H.shape, powers.shape, H.prime
    alone = H.alone(second, at)
    n = alone.shape[1] - p
    A, C = alone[:, :n, :n], alone[:, n:, :n]
    columns: list[Residues] = [alone[:, :n, n:]]  # A^k B
    for _ in range(length - 1):
        columns.append(multiplied(A, columns[-1], prime))
    krylov = np.moveaxis(np.array(columns), 0, 3)  # (nodes, n, q, length)
    conditions = list(krylov[..., ::-1].reshape(count, n, -1))
    if n > degree:  # what is not observable may be anything
        bases = [_observable(x, c, prime) for x, c in zip(A, C, strict=True)]
        conditions = [
            multiplied(basis, rows, prime) for basis, rows in zip(bases, conditions, strict=True)
        ]
    equations = [_outer(rows, power[None], prime) for rows, power in zip(conditions, powers, strict=True)]
    u = _null_space(np.vstack(equations), H, most)
    later = multiplied(C, krylov[..., :-1].reshape(count, n, -1), prime).reshape(count, p, q, -1)
    impulse = np.concatenate([alone[:, n:, n:, None], later], axis=3)
    impulse = entrywise(impulse.reshape(count, -1, 1), powers[:, None], prime)
    impulse = multiplied(modes, impulse.reshape(count, -1), prime).reshape(count, p, q, length, wide)
    y = np.zeros((count, p, length, q, length, wide), dtype=np.int64)
    for k in range(length):
        y[:, :, k:, :, k] = np.moveaxis(impulse[:, :, :, : length - k], 3, 2)
    if count > wide:
        too_high = multiplied(y[wide:].reshape(-1, q * length * wide), u, prime)
        u = multiplied(u, _null_space(too_high, H), prime)
    return u, multiplied(np.moveaxis(y[:wide], 0, 2).reshape(p * length * wide, -1), u, prime)


def _null_space(equations: Residues, H: _Function, most: int | None = None) -> Residues:
    """Columns that span the null space, or `most` random combinations of more."""
    H.work.add(exact_elimination(*equations.shape))
    basis = null_space(equations, H.prime)
    free = basis.shape[1]
    if most is None or free <= most:
        return basis
    chosen = np.random.default_rng(most).integers(1, H.prime, (free, most), dtype=np.int64)
    return multiplied(basis, chosen, H.prime)


def _observable(A: Residues, C: Residues, prime: int) -> Residues:
    """Rows that span C, C A, C A^2, ..."""
    return reachable_bases(A.T, C.T, [len(A)], prime)[0].basis


def _inside(E: _Span, prime: int, *moves: Mapping[str, int]) -> int:
    """Dimension of the functions f in E whose products with all monomials of `moves` are in it, too."""
    return len(E.rows) - rank(_left(E, prime, *moves), prime)


def _left(E: _Span, prime: int, *moves: Mapping[str, int]) -> Residues:
    """What is left outside of E of the products of its rows with monomials.

    A product is known in E by its values in the pivots; what is left elsewhere has to vanish.
    """
    others = np.setdiff1d(np.arange(E.rows.shape[1]), E.pivots)
    left = []
    for move in moves:
        factors = np.ones(E.rows.shape[1], dtype=np.int64)
        for name, power in move.items():
            factors = entrywise(
                factors, powers_of(E.samples.points[name], power + 1, prime)[:, -1], prime
            )
        differences = (factors[others] - factors[E.pivots, None]) % prime
        left.append(entrywise(E.rows[:, others], differences, prime))
    return np.hstack(left)


def _outer(a: Residues, b: Residues, prime: int) -> Residues:
    """Products (N, m n) of the entries of rows (N, m) and (N, n)."""
    products = entrywise(a[:, :, None], b[:, None, :], prime)
    return products.reshape(products.shape[0], -1)


def cannot_be_single(a: ExactLFT, names: Sequence[str], work: Work) -> bool:
    """Whether no LFT has each of three deltas once, in which the value is affine."""
    H = _function(a, names, work, is_transposed=False)
    if H.order == len(names):
        return False
    return not any(_can_be_between(H, *order) for order in permutations(names))


def _can_be_between(H: _Function, before: str, middle: str, after: str) -> bool:
    """Whether the slope in the middle delta can be a column of the last times a row of the first."""
    p, q = H.shape
    at = np.random.default_rng(1).integers(1, H.prime, (2, 2), dtype=np.int64)
    alone = H.alone(middle, {before: np.tile(at[0], 2), after: np.repeat(at[1], 2)})
    n = alone.shape[1] - p
    slopes = multiplied(alone[:, n:, :n], alone[:, :n, n:], H.prime).reshape(2, 2, p, q)
    return rank(slopes.swapaxes(1, 2).reshape(2 * p, 2 * q), H.prime) <= 1
