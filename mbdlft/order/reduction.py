"""LFTs of exact numbers, and their n-D reduction: every rank is decided exactly.

Reduction keeps, for each delta, the smallest subspace S_k with range(M12_k) in S_k and M11_kj S_j in S_k,
and then the same for the transposed LFT. It is exact, and minimal if the deltas did not commute:
D'Andrea, Khatri (1997); Beck, Doyle (1999). The subspaces are found on residues. The candidates that are
kept there are kept in balls, too; in these, a basis of S_k is the identity in some channels,
w = T w[chosen]. No vector is made orthonormal: balls have the bits.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.exact.matrices import (
    ExactMatrix,
    Residues,
    identity,
    limbs,
    multiplied,
    rough_values,
    row_echelon,
    stacked,
    times,
    zeros,
)
from mbdlft.lft.block import Block, consecutive
from mbdlft.lft.lft import LFT
from mbdlft.order.reduction_in_doubles import channel_scales


@dataclass(frozen=True, slots=True, eq=False)
class ExactLFT:
    """value = M22 + M21 Delta (I - M11 Delta)^-1 M12, in exact numbers: M is [M11 M12 ; M21 M22].

    Blocks are sorted by name.
    """

    M: ExactMatrix
    blocks: tuple[Block, ...]

    @property
    def order(self) -> int:
        """n, the sum of all repetitions."""
        return sum(block.size for block in self.blocks)

    @property
    def parts(self) -> list[slice]:
        """Rows of each block."""
        return consecutive(block.size for block in self.blocks)

    def rounded(self) -> LFT:
        """The LFT in doubles; see `ExactMatrix.values`."""
        values, n = self.M.values(), self.order
        return LFT(values[:n, :n], values[:n, n:], values[n:, :n], values[n:, n:], self.blocks)


def transposed(a: ExactLFT) -> ExactLFT:
    """The LFT of the transposed value."""
    return ExactLFT(a.M.T, a.blocks)


def eliminated(a: ExactLFT, count: int, rows: list[int]) -> ExactLFT:
    """The LFT with the first `count` inputs u solved for such that the first outputs vanish.

    With 0 = a u + b v, y = c u + d v the result has those of [u ; y] in `rows` as outputs. A
    ZeroDivisionError if a is singular at nominal.
    """
    n, M = a.order, a.M
    inner, others = slice(n, n + count), [*range(n), *range(n + count, M.shape[1])]
    solution = -M[inner, inner].solve(M[inner, others])  # of u, in w and v
    outside = [*range(n), *range(n + count, M.shape[0])]
    reduced = M[outside][:, others] + M[outside][:, inner] @ solution
    both = stacked([[reduced[:n]], [solution], [reduced[n:]]])
    return ExactLFT(both[[*range(n), *(n + k for k in rows)]], a.blocks)


def residues_alone(a: ExactLFT) -> ExactLFT:
    """What decides ranks and zeros, without the balls that carry values: it can go to another process."""
    M = a.M
    return ExactLFT(ExactMatrix(M.residues, np.empty((0, 0), object), M.prime), a.blocks)


_MOST_FACTOR, _MOST_EXCHANGES = 2.0, 4


def reduce_exactly(a: ExactLFT) -> ExactLFT:
    """The LFT of equal value whose order is minimal for deltas that do not commute."""
    return transposed(_compressed(transposed(_compressed(a))))


class Space:
    """A subspace that grows: its reduced echelon form, and which candidates were taken at each step.

    The basis (dimension, n) is the identity in the columns `pivots`; `taken` are, for each step, the
    candidates that were independent of all before.
    """

    def __init__(self, size: int, prime: int) -> None:
        self.size, self.prime = size, prime
        self.basis: Residues = np.zeros((0, size), dtype=np.int64)
        self.pivots: list[int] = []
        self.taken: list[list[int]] = []

    def extend(self, candidates: Residues) -> Residues:
        """Add candidates (count, n); those that were independent."""
        used = np.flatnonzero(np.any(candidates != 0, axis=1))
        if len(self.pivots) == self.size or not len(used):
            self.taken.append([])
            return candidates[:0]
        outside = candidates[used]
        if self.pivots:
            inside = multiplied(outside[:, self.pivots], self.basis, self.prime)
            outside = (outside - inside) % self.prime
            some = np.any(outside != 0, axis=1)
            used, outside = used[some], outside[some]
        _, which = row_echelon(np.ascontiguousarray(outside.T), self.prime)
        taken = used[which]
        self.taken.append(taken.tolist())
        if len(which):
            fresh, pivots = row_echelon(outside[which], self.prime)
            if self.pivots:
                inside = multiplied(self.basis[:, pivots], fresh, self.prime)
                self.basis = (self.basis - inside) % self.prime
            self.basis = np.vstack([self.basis, fresh])
            self.pivots += pivots
        return candidates[taken]


def reachable_bases(M11: Residues, M12: Residues, sizes: list[int], prime: int) -> list[Space]:
    """The smallest subspaces S_k with range(M12_k) in S_k and M11_kj S_j in S_k."""
    blocks = consecutive(sizes)
    spaces = [Space(size, prime) for size in sizes]
    fresh = [
        space.extend(np.ascontiguousarray(M12[block].T))
        for space, block in zip(spaces, blocks, strict=True)
    ]
    rows: dict[int, tuple[NDArray[np.intp], Array]] = {}  # of M11', by block: used in many steps
    while sources := [k for k, columns in enumerate(fresh) if len(columns)]:
        ends = np.cumsum([0, *(len(fresh[k]) for k in sources)]).tolist()
        candidates = np.zeros((ends[-1], len(M11)), dtype=np.int64)
        for k, (first, end) in zip(sources, pairwise(ends), strict=True):
            if k not in rows:
                used = np.flatnonzero(M11[:, blocks[k]].any(axis=1))
                rows[k] = used, limbs(M11[used, blocks[k]].T)
            used, read = rows[k]
            if len(used):
                candidates[first:end, used] = times(fresh[k], read, prime)
        fresh = [space.extend(candidates[:, block]) for space, block in zip(spaces, blocks, strict=True)]
    return spaces


def _krylov(a: ExactLFT, spaces: list[Space]) -> list[ExactMatrix]:
    """The candidates that were taken, (n_k, dimension) for each block; no other is computed."""
    n, blocks, prime = a.order, a.parts, a.M.prime
    fresh = [a.M[block, n:][:, space.taken[0]] for block, space in zip(blocks, spaces, strict=True)]
    bases = fresh
    for step in range(1, max((len(space.taken) for space in spaces), default=0)):
        sources = [k for k, one in enumerate(fresh) if one.shape[1]]
        ends = np.cumsum([0, *(fresh[k].shape[1] for k in sources)]).tolist()
        following = []
        for block, space in zip(blocks, spaces, strict=True):
            taken = np.array(space.taken[step], dtype=int)
            columns = [zeros(block.stop - block.start, 0, prime)]
            for k, (first, end) in zip(sources, pairwise(ends), strict=True):
                mine = taken[(taken >= first) & (taken < end)] - first
                if len(mine):
                    columns.append(a.M[block, blocks[k]] @ fresh[k][:, mine])
            following.append(stacked([columns]))
        fresh = following
        bases = [stacked([[old, new]]) for old, new in zip(bases, fresh, strict=True)]
    return bases


class _Graph(NamedTuple):
    """A basis (n_k, d) that is the identity in the rows `chosen`, sorted."""

    chosen: NDArray[np.int64]
    basis: ExactMatrix


def _compressed(a: ExactLFT) -> ExactLFT:
    """Restrict each delta to its reachable subspace."""
    n, channels, prime = a.order, a.parts, a.M.prime
    residues = a.M.residues
    sizes = [block.size for block in a.blocks]
    spaces = reachable_bases(residues[:n, :n], residues[:n, n:], sizes, prime)
    if [len(space.pivots) for space in spaces] == sizes:
        return a
    M = rough_values(a.M)
    scale = channel_scales(M[:n, :n], M[:n, n:], M[n:, :n])
    graphs = [
        _graph(space, krylov, scale[part])
        for space, krylov, part in zip(spaces, _krylov(a, spaces), channels, strict=True)
    ]
    kept = [part.start + row for part, g in zip(channels, graphs, strict=True) for row in g.chosen]
    kept_rows = a.M[[*kept, *range(n, a.M.shape[0])]]
    columns = [_in_basis(kept_rows[:, part], g) for part, g in zip(channels, graphs, strict=True)]
    blocks = [Block(block.name, len(g.chosen)) for block, g in zip(a.blocks, graphs, strict=True)]
    return ExactLFT(stacked([[*columns, kept_rows[:, n:]]]), tuple(blocks))


def _in_basis(columns: ExactMatrix, graph: _Graph) -> ExactMatrix:
    """Columns (m, n_k) times a basis that is the identity in its chosen rows."""
    others = np.setdiff1d(np.arange(columns.shape[1]), graph.chosen)
    chosen = columns[:, graph.chosen]
    return chosen + columns[:, others] @ graph.basis[others] if len(others) else chosen


def _graph(space: Space, krylov: ExactMatrix, scale: Array) -> _Graph:
    """A basis of a subspace in coordinates that are channels, with factors of moderate size.

    `scale` (n,) is that of the channels, in which they have one size.
    """
    n, d = krylov.shape
    if d in (0, n):
        return _Graph(np.arange(d), identity(n, space.prime)[:, :d])
    first = np.array(space.pivots)
    basis = _over_rows(krylov, first)
    rows = _best_rows(scale[:, None] * rough_values(basis) / scale[first], first)
    try:
        other = basis if np.array_equal(rows, first) else _over_rows(basis, rows)
    except ZeroDivisionError:  # doubles chose rows that depend on each other
        rows, other = first, basis
    order = np.argsort(rows)
    return _Graph(rows[order], other[:, order])


def _over_rows(basis: ExactMatrix, rows: NDArray[np.int64]) -> ExactMatrix:
    """The basis of the same space that is the identity in some rows."""
    return basis[rows].T.solve(basis.T).T


def _best_rows(basis: Array, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rows in which a basis has no factors above `_MOST_FACTOR`, from those in which it is the identity.

    Each exchange of a row multiplies the determinant of the chosen rows by such a factor.
    """
    rows, basis = rows.copy(), basis.copy()
    for _ in range(_MOST_EXCHANGES * len(rows)):
        row, column = np.unravel_index(np.argmax(np.abs(basis)), basis.shape)
        if abs(basis[row, column]) <= _MOST_FACTOR:
            break
        rows[column] = row
        basis[:, column] /= basis[row, column]
        pivot_row = basis[row].copy()
        pivot_row[column] = 0.0
        basis -= np.outer(basis[:, column], pivot_row)
    return rows
