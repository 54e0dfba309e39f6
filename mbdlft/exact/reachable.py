"""The smallest LFT of a matrix of exact numbers: each delta restricted to the subspace that it reaches.

The reduction of a linear fractional transformation [M11 M12 ; M21 M22] of deltas keeps, for each of them,
the smallest subspace S_k with range(M12_k) in S_k and M11_kj S_j in S_k, and then the same of the
transpose. It is exact, and minimal if the deltas did not commute: D'Andrea, Khatri (1997); Beck, Doyle
(1999). The subspaces are found on residues. A basis of S_k is the identity in some channels,
w = T w[chosen]. Residues say which of its other entries are zero, as most are; the rest are found in
balls, row by row. No vector is made orthonormal there: subtractions cost balls more bits than powers of
M11 do. Orthonormal vectors in doubles choose the channels in which a large basis costs few bits.
"""

from collections.abc import Sequence
from contextlib import suppress
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.exact.matrices import ExactMatrix, identity, of_residues, rough_values, stacked, zeros
from mbdlft.exact.modular import (
    Space,
    parts_of,
    pivot_columns,
    reachable_bases,
    reduced_residues,
    row_echelon,
)
from mbdlft.exact.rounding import channel_scales, or_one

_MOST_FACTOR, _MOST_EXCHANGES = 2.0, 4  # of a basis, and for each of its vectors
_MOST_BY_BALLS = 200  # channels: of more, doubles choose the rows in which a basis costs few bits


def reduced(
    M: ExactMatrix, sizes: Sequence[int], outputs: int | None = None
) -> tuple[ExactMatrix, list[int]]:
    """The smallest [M11 M12 ; M21 M22] of equal value, and repetitions of its deltas.

    Of equal value are so many outputs, all by default. What the others are is what these need.
    """
    if outputs is None and M.known_balls is None:
        residues, sizes = reduced_residues(M.residues, list(sizes), M.prime)
        return of_residues(residues, M.prime), sizes
    M, sizes = _compressed(M, list(sizes), M.shape[1] - sum(sizes))
    M, sizes = _compressed(M.T, sizes, M.shape[0] - sum(sizes) if outputs is None else outputs)
    return M.T, sizes


def _compressed(whole: ExactMatrix, sizes: list[int], inputs: int) -> tuple[ExactMatrix, list[int]]:
    """Each delta restricted to the subspace that it reaches from the first inputs."""
    n, blocks = sum(sizes), parts_of(sizes)
    M = whole[:, : n + inputs]
    by_doubles = n > _MOST_BY_BALLS
    spaces = reachable_bases(M.residues[:n, :n], M.residues[:n, n:], sizes, M.prime, is_traced=by_doubles)
    small = _partial(spaces)
    if not small:
        return whole, sizes
    rough = rough_values(M)
    scale = channel_scales(rough[:n, :n], rough[:n, n:], rough[n:, :n])
    if by_doubles:
        scaled = scale[:, None] * rough[:n]
        roughly = _orthonormal(np.hstack([scaled[:, :n] / scale, scaled[:, n:]]), blocks, spaces)
        spaces = [_in_rows(space, _pivot_rows(Q)) for space, Q in zip(spaces, roughly, strict=True)]
    graphs = [
        _graph(basis, spaces[k].pivots, scale[blocks[k]])
        for k, basis in zip(small, _bases(M, blocks, spaces), strict=True)
    ]
    chosen = [np.arange(size) for size in sizes]
    for k, graph in zip(small, graphs, strict=True):
        chosen[k] = graph.chosen
    sizes = [len(rows) for rows in chosen]
    kept = np.concatenate([block.start + rows for block, rows in zip(blocks, chosen, strict=True)])
    rows = whole[np.append(kept, range(n, M.shape[0]))]
    result = rows[:, np.append(kept, range(n, whole.shape[1]))]
    parts = parts_of(sizes)
    for k, (chosen_rows, basis) in zip(small, graphs, strict=True):
        others = np.setdiff1d(np.arange(basis.shape[0]), chosen_rows)
        moved = rows[:, blocks[k].start + others] @ basis[others]
        result[:, parts[k]] = result[:, parts[k]] + moved
    return result, sizes


def _krylov(M: ExactMatrix, blocks: list[slice], spaces: list[Space]) -> list[ExactMatrix]:
    """The candidates that were taken, (n_k, dimension) for each block; no other is computed."""
    n, prime = blocks[-1].stop, M.prime
    fresh = [M[block, n:][:, space.taken[0]] for block, space in zip(blocks, spaces, strict=True)]
    bases = fresh
    for step in range(1, max((len(space.taken) for space in spaces), default=0)):
        sources = [k for k, columns_of in enumerate(fresh) if columns_of.shape[1]]
        ends = np.cumsum([0, *(fresh[k].shape[1] for k in sources)]).tolist()
        following = []
        for block, space in zip(blocks, spaces, strict=True):
            taken = np.array(space.taken[step], dtype=int)
            columns = [zeros(block.stop - block.start, 0, prime)]
            for k, (first, end) in zip(sources, pairwise(ends), strict=True):
                mine = taken[(taken >= first) & (taken < end)] - first
                if len(mine):
                    columns.append(M[block, blocks[k]] @ fresh[k][:, mine])
            following.append(stacked([columns]))
        fresh = following
        bases = [stacked([[old, new]]) for old, new in zip(bases, fresh, strict=True)]
    return bases


def _orthonormal(M: Array, blocks: list[slice], spaces: list[Space]) -> list[Array]:
    """Orthonormal bases (n_k, d_k) in doubles; residues say which candidates are new.

    These are the same for orthonormal vectors: what is subtracted came before, and so did its candidates.
    """
    n = len(M)
    bases = [np.zeros((block.stop - block.start, 0)) for block in blocks]
    moved = M[:, n:]
    for step in range(max(len(space.taken) for space in spaces)):
        images = []
        for k, (block, space) in enumerate(zip(blocks, spaces, strict=True)):
            fresh = moved[block][:, space.taken[step]]
            for _ in range(2):  # twice is enough
                fresh = fresh / or_one(np.linalg.norm(fresh, axis=0))
                fresh = np.linalg.qr(fresh - bases[k] @ (bases[k].T @ fresh))[0]
            bases[k] = np.hstack([bases[k], fresh])
            images.append(M[:, block] @ fresh)
        moved = np.hstack(images)
    return bases


def _pivot_rows(Q: Array) -> NDArray[np.int64]:
    """Rows (d,) in which a basis (n, d) is well conditioned: the largest of each step of elimination."""
    left, rows = Q.copy(), np.zeros(Q.shape[1], dtype=np.int64)
    for k in range(len(rows)):
        rows[k] = row = np.argmax(np.abs(left[:, k]))
        left[:, k + 1 :] -= np.outer(left[:, k] / left[row, k], left[row, k + 1 :])
    return rows


def _in_rows(space: Space, rows: NDArray[np.int64]) -> Space:
    """The space with the identity in those of some rows that do not depend on those before them.

    Doubles chose the rows: where these lose all digits of a vector, a row comes twice.
    """
    order = np.array([*dict.fromkeys([*rows.tolist(), *range(space.size)])], dtype=np.int64)
    basis, pivots = row_echelon(space.basis[:, order], space.prime)
    other = Space(space.size, space.prime)
    other.basis, other.pivots = basis[:, np.argsort(order)], order[pivots].tolist()
    other.taken = space.taken
    return other


class _Basis:
    """A basis (n, d) of a space, the identity in its pivots, of which balls are found row by row.

    A row is a sum of the rows of the pivots where it has entries, in all vectors of the space: of so many
    entries, as many of the vectors give the balls. Rows with entries in the same columns are a group.
    """

    def __init__(self, space: Space, vectors: ExactMatrix) -> None:
        self.vectors, self.pivots = vectors, np.array(space.pivots, dtype=np.int64)
        self.matrix = zeros(space.size, len(self.pivots), space.prime)
        self.matrix[self.pivots] = identity(len(self.pivots), space.prime)
        self.matrix.residues[:] = space.basis.T
        some, groups = self.matrix.residues != 0, dict[bytes, list[int]]()
        for row in np.setdiff1d(np.flatnonzero(some.any(axis=1)), self.pivots).tolist():
            groups.setdefault(some[row].tobytes(), []).append(row)
        self.waiting = list(groups.values())

    def is_solved(self) -> bool:
        """Whether the vectors give all rows; those that they do are found."""
        self.waiting = [rows for rows in self.waiting if not self._are_solved(rows)]
        return not self.waiting

    def _are_solved(self, group: list[int]) -> bool:
        rows = np.array(group)
        residues, prime = self.vectors.residues, self.vectors.prime
        columns = np.flatnonzero(self.matrix.residues[rows].any(axis=0))
        chosen = self.pivots[columns]
        some = np.flatnonzero(residues[chosen].any(axis=0))
        taken = some[:1]
        if len(columns) > 1:
            taken = some[pivot_columns(residues[np.ix_(chosen, some)], prime)]
        if len(taken) < len(columns):
            return False
        solution = self.vectors[np.ix_(chosen, taken)].T.solve(self.vectors[np.ix_(rows, taken)].T)
        self.matrix[np.ix_(rows, columns)] = solution.T
        return True

    def merge(self) -> None:
        """Make one group of those that are solved for in less time together, as they share columns."""
        some, merged = self.matrix.residues != 0, list[tuple[list[int], NDArray[np.bool_]]]()
        for rows in sorted(self.waiting, key=lambda rows: -np.count_nonzero(some[rows[0]])):
            columns = some[rows[0]]
            for k, (others, of_others) in enumerate(merged):
                apart = np.count_nonzero(columns) ** 3 + np.count_nonzero(of_others) ** 3
                if np.count_nonzero(columns | of_others) ** 3 < apart:
                    merged[k] = [*others, *rows], columns | of_others
                    break
            else:
                merged.append((rows, columns))
        self.waiting = [rows for rows, _ in merged]

    @property
    def unknown(self) -> NDArray[np.int64]:
        """The rows that are not found."""
        return np.array([row for rows in self.waiting for row in rows], dtype=np.int64)

    @property
    def known(self) -> NDArray[np.bool_]:
        """The columns (d,) whose balls are all found."""
        return np.asarray(~self.matrix.residues[self.unknown].any(axis=0))

    def times(self, left: ExactMatrix, columns: NDArray[np.bool_]) -> ExactMatrix:
        """A matrix (m, n) times some columns, but for the rows of these that are not found."""
        found = np.ones(left.shape[1], dtype=bool)
        found[self.pivots] = found[self.unknown] = False
        return left[:, self.pivots[columns]] + left[:, found] @ self.matrix[found][:, columns]


def _partial(spaces: Sequence[Space]) -> list[int]:
    """Those that are not the whole space."""
    return [k for k, space in enumerate(spaces) if len(space.pivots) < space.size]


def _bases(M: ExactMatrix, blocks: list[slice], spaces: list[Space]) -> list[ExactMatrix]:
    """The basis (n_k, d_k) of each space that is not the whole one, the identity in its pivots.

    Vectors of a space are the columns of M12 and what M11 makes of columns of the bases that are known:
    most of these have a one only, and give columns of M11. Powers of M11 are left for rows that need
    each other.
    """
    n, is_whole = blocks[-1].stop, np.ones(blocks[-1].stop, dtype=bool)
    small = _partial(spaces)
    for k in small:
        is_whole[blocks[k]] = False
    inner, parts = M[np.flatnonzero(~is_whole)], parts_of([spaces[k].size for k in small])
    vectors = inner[:, n:]
    bases = [_Basis(spaces[k], vectors[part]) for k, part in zip(small, parts, strict=True)]
    images = [inner[:, np.flatnonzero(is_whole)]]
    known = [np.zeros(len(basis.pivots), dtype=bool) for basis in bases]
    while not all([basis.is_solved() for basis in bases]):
        before, known = known, [basis.known for basis in bases]
        for basis, k, now, old in zip(bases, small, known, before, strict=True):
            if np.any(now & ~old):
                images.append(basis.times(inner[:, blocks[k]], now & ~old))
        vectors = stacked([[inner[:, :0], *images]])
        if not vectors.shape[1]:
            _solve_together(M, [blocks[k] for k in small], bases)
            break
        for basis, part in zip(bases, parts, strict=True):
            basis.vectors = stacked([[basis.vectors, vectors[part]]])
        images = []
    return [basis.matrix for basis in bases]


def _solve_together(M: ExactMatrix, blocks: list[slice], bases: list[_Basis]) -> None:
    """The rows that are not found, of M11 in the coordinates that these and their columns need."""
    kept = [np.append(basis.pivots[~basis.known], basis.unknown) for basis in bases]
    of_rows = M[np.concatenate([block.start + rows for block, rows in zip(blocks, kept, strict=True)])]
    parts = []
    for basis, block in zip(bases, blocks, strict=True):
        of_block = of_rows[:, block]
        parts += [basis.times(of_block, ~basis.known), of_block[:, basis.unknown]]
    vectors = stacked([[basis.vectors[rows]] for basis, rows in zip(bases, kept, strict=True)])
    left, sizes = stacked([[*parts, vectors]]), [len(rows) for rows in kept]
    n = sum(sizes)
    spaces = reachable_bases(left.residues[:, :n], left.residues[:, n:], sizes, M.prime, is_traced=True)
    for basis, rows, vectors in zip(bases, kept, _krylov(left, parts_of(sizes), spaces), strict=True):
        basis.vectors = zeros(basis.matrix.shape[0], vectors.shape[1], M.prime)
        basis.vectors[rows] = vectors
        basis.merge()
        basis.is_solved()


class _Graph(NamedTuple):
    """A basis (n_k, d) that is the identity in the rows `chosen`, sorted."""

    chosen: NDArray[np.int64]
    basis: ExactMatrix


def _graph(basis: ExactMatrix, pivots: Sequence[int], scale: Array) -> _Graph:
    """A basis in coordinates that are channels of a size (n,), with moderate factors.

    It was the identity in its pivots.
    """
    rows = np.array(pivots, dtype=np.int64)
    chosen = _best_rows(scale[:, None] * rough_values(basis) / scale[rows], rows)
    if not np.array_equal(rows, chosen):
        with suppress(ZeroDivisionError):  # doubles chose them: they depend on each other
            basis, rows = over_rows(basis, chosen), chosen
    order = np.argsort(rows)
    return _Graph(rows[order], basis[:, order])


def over_rows(basis: ExactMatrix, rows: NDArray[np.int64]) -> ExactMatrix:
    """The basis of the same space that is the identity in some rows.

    X with X [1 0 ; B C] = Y is found in balls for C and for other rows only: of a basis that was the
    identity in most of these rows, C is small.
    """
    others = np.setdiff1d(np.arange(basis.shape[0]), rows)
    chosen, Y = basis[rows], basis[others]
    ones = (np.count_nonzero(chosen.residues, axis=1) == 1) & np.any(chosen.residues == 1, axis=1)
    heads, first = np.unique(np.argmax(chosen.residues, axis=1)[ones], return_index=True)
    of_one = np.flatnonzero(ones)[first]
    others_of, tails = (np.setdiff1d(np.arange(len(rows)), columns_of) for columns_of in (of_one, heads))
    solved = chosen[np.ix_(others_of, tails)].T.solve(Y[:, tails].T).T
    unsolved = Y[:, heads] + (-(solved @ chosen[np.ix_(others_of, heads)]))
    below = stacked([[unsolved, solved]])[:, np.argsort([*of_one, *others_of])]
    whole = stacked([[identity(len(rows), basis.prime)], [below]])
    return whole[np.argsort([*rows, *others])]


def _best_rows(basis: Array, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rows in which a basis has no factors above `_MOST_FACTOR`: each exchange has such a factor."""
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
