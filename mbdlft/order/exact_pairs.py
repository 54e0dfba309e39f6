"""Pairs and triples of deltas that cannot all have their degree, proved on residues modulo a prime.

The numbers are those of `mbdlft.order.sections`, where they are read from singular values. Here all
other deltas have random residues, functions are known by their values at random residues, polynomials
are found by interpolation, and ranks are exact. Theorems and proofs: docs/method.md, section "Pairs that
cannot both be smallest".
"""

from collections.abc import Mapping, Sequence
from itertools import product, takewhile
from math import ceil, prod
from typing import NamedTuple

import numpy as np

from mbdlft.exact.matrices import (
    Residues,
    multiplied,
    null_space,
    rank,
    row_echelon,
    solved,
)
from mbdlft.order.exact_degree import at_random, minimal, some
from mbdlft.order.reduction import ExactLFT
from mbdlft.order.work import Work, exact_solutions

_EXTRA = 2  # samples more than needed
_MOST_COEFFICIENTS = 400  # of polynomials u: what has more is left open


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
        n, p, found = self.order, self.shape[0], []
        self.work.add(exact_solutions(len(points), n + self.shape[1]))
        M, one = self.M[:, :n].astype(object), np.eye(n, dtype=object)
        sizes = [part.stop - part.start for part in self.parts.values()]
        B = self.M[:n, n:]
        for point in points:
            delta = np.repeat([point[name] for name in self.parts], sizes)
            columns = M * delta.astype(object)
            loop = np.asarray((one - columns[:n]) % self.prime, dtype=np.int64)
            C = np.asarray(columns[n:] % self.prime, dtype=np.int64)
            found.append(multiplied(C, solved(loop, B, self.prime), self.prime))
        return np.array(found, dtype=np.int64).reshape(len(points), p, -1)


class _Span(NamedTuple):
    """E: independent columns (samples, dimension), the points of the samples, k values alpha."""

    columns: Residues
    points: Sequence[Mapping[str, int]]
    k: int


def more_needed(
    a: ExactLFT,
    first: str,
    second: str,
    degrees: Mapping[str, int],
    work: Work,
    *,
    is_transposed: bool,
) -> tuple[int, int]:
    """Repetitions that each of two deltas needs above its degree if the other has none.

    (0, 0) if nothing is proved: both may have their degree.
    """
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
    E = _span(H, first, {second: power, third: 2}, degrees)
    if E is None:
        return False
    return _inside(E, H.prime, {second: power}, {third: 1}, {second: power, third: 1}) > 0


def _function(a: ExactLFT, names: Sequence[str], work: Work, *, is_transposed: bool) -> _Function:
    sizes = {block.name: block.size for block in a.blocks}
    own = np.concatenate(
        [
            np.arange(p.start, p.stop)
            for b, p in zip(a.blocks, a.parts, strict=True)
            if b.name in names
        ]
    )
    order = [block.name for block in a.blocks if block.name in names]
    prime = a.M.prime
    given = at_random(a).T if is_transposed else at_random(a)
    M, counts = minimal(some(given, own, a.order), [sizes[name] for name in order], prime)
    n = sum(counts)
    # inputs and outputs that are combinations of others do not matter
    _, columns = row_echelon(M[:n, n:], prime)
    _, rows = row_echelon(np.ascontiguousarray(M[n:, :n].T), prime)
    M = M[np.ix_([*range(n), *(n + k for k in rows)], [*range(n), *(n + k for k in columns)])]
    ends = np.cumsum([0, *counts]).tolist()
    parts = {name: slice(s, e) for name, s, e in zip(order, ends[:-1], ends[1:], strict=True)}
    return _Function(M, parts, prime, work)


def _more(H: _Function, first: str, second: str, degrees: Mapping[str, int]) -> int:
    """h and kappa as in `sections.obstruction`, and what the second delta then needs."""
    length = degrees[second] + 2
    E = _span(H, first, {second: length}, degrees)
    if E is None or E.columns.shape[1] - _inside(E, H.prime, {second: 1}) != degrees[first]:
        return 0
    dimensions = takewhile(
        bool, (_inside(E, H.prime, {second: length + j}) for j in range(_EXTRA + 1))
    )
    return max((ceil(h / E.k) + before for before, h in enumerate(dimensions)), default=0)


def _span(
    H: _Function, first: str, lengths: Mapping[str, int], degrees: Mapping[str, int]
) -> _Span | None:
    """E of the polynomials u with so many powers of each delta but the first; None if too large."""
    (p, q), prime = H.shape, H.prime
    if q * prod(lengths.values()) > _MOST_COEFFICIENTS:
        return None
    random = np.random.default_rng(1)

    def draw(count: int) -> list[int]:
        return [int(x) for x in random.integers(1, prime, count, dtype=np.int64)]

    axes = {name: draw(2 * n + degrees[name] + _EXTRA) for name, n in lengths.items()}
    grid = [dict(zip(axes, at, strict=True)) for at in product(*axes.values())]
    monomials = _monomials(grid, lengths, prime)  # of u, on the grid
    high, low = _modes(axes, lengths, prime)
    # one random direction and value of the first delta each time: enough of them tell functions apart
    points, left = [], []
    for own in draw(degrees[first] + _EXTRA):
        direction = draw(p)
        points += [{first: own, **at} for at in grid]
        left += [direction] * len(grid)
    seen = _seen(H.at(points), np.array(left), prime)
    powers = np.tile(monomials, (degrees[first] + _EXTRA, 1))
    all_Hu = _times(seen, powers, prime)
    all_y = _times(np.array(left), powers, prime)
    E = np.zeros((len(points), 0), dtype=np.int64)
    for k, alpha in enumerate(draw(2 * degrees[first] + 2)):
        value = H.at([{first: alpha, **at} for at in grid])
        # H u at the grid by entries of y: (grid, p, coefficients of u)
        Hu = np.hstack([_times(value[:, i], monomials, prime) for i in range(p)])
        count = all_Hu.shape[1]
        u = null_space(multiplied(high, Hu, prime).reshape(-1, count), prime)
        y = multiplied(multiplied(low, Hu, prime).reshape(-1, count), u, prime)
        y = y.reshape(len(low), p, -1).swapaxes(0, 1).reshape(p * len(low), -1)
        sections = (multiplied(all_Hu, u, prime) - multiplied(all_y, y, prime)) % prime
        over = [pow(point[first] - alpha, -1, prime) for point in points]
        sections = _scaled(over, sections, prime)
        both = np.hstack([E, sections])
        _, pivots = row_echelon(both, prime)
        if len(pivots) == E.shape[1]:
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


def _monomials(
    points: Sequence[Mapping[str, int]], lengths: Mapping[str, int], prime: int
) -> Residues:
    """Values (points, coefficients) of the products of powers below `lengths`."""
    powers = list(product(*(range(n) for n in lengths.values())))
    return np.array(
        [
            [
                prod(pow(at[name], k, prime) for name, k in zip(lengths, one, strict=True)) % prime
                for one in powers
            ]
            for at in points
        ],
        dtype=np.int64,
    )


def _interpolation(axes: Mapping[str, list[int]], prime: int) -> Residues:
    """Values on a grid to coefficients of polynomials."""
    found = np.ones((1, 1), dtype=np.int64)
    for nodes in axes.values():
        vandermonde = np.array(
            [[pow(x, k, prime) for k in range(len(nodes))] for x in nodes], dtype=np.int64
        )
        inverse = solved(vandermonde, np.eye(len(nodes), dtype=np.int64), prime)
        found = _kronecker(found, inverse, prime)
    return found


def _kronecker(a: Residues, b: Residues, prime: int) -> Residues:
    outer = multiplied(a.reshape(-1, 1), b.reshape(1, -1), prime)
    blocks = outer.reshape(*a.shape, *b.shape).swapaxes(1, 2)
    return np.asarray(blocks.reshape(len(a) * len(b), -1))


def _modes(
    axes: Mapping[str, list[int]], lengths: Mapping[str, int], prime: int
) -> tuple[Residues, Residues]:
    """From values on the grid to coefficients beyond the degrees of u, zero for it; to the others."""
    places = product(*(range(len(nodes)) for nodes in axes.values()))
    below = [all(k < n for k, n in zip(one, lengths.values(), strict=True)) for one in places]
    is_low, all_modes = np.array(below), _interpolation(axes, prime)
    return all_modes[~is_low], all_modes[is_low]


def _seen(values: Residues, left: Residues, prime: int) -> Residues:
    """left' values (N, inputs) for values (N, outputs, inputs)."""
    products = left.astype(object)[:, :, None] * values.astype(object)
    return np.asarray(np.sum(products, axis=1) % prime, dtype=np.int64)


def _times(entries: Residues, powers: Residues, prime: int) -> Residues:
    """Products (N, m n) of entries (N, m) and powers (N, n)."""
    products = entries.astype(object)[:, :, None] * powers.astype(object)[:, None, :]
    return np.asarray(products % prime, dtype=np.int64).reshape(len(entries), -1)


def _scaled(factors: Sequence[int], rows: Residues, prime: int) -> Residues:
    """Rows times their factors."""
    products = np.array(factors, dtype=object)[:, None] * rows.astype(object)
    return np.asarray(products % prime, dtype=np.int64)
