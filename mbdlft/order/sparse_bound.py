"""Degrees of a sparse LFT: the lower bounds of its repetitions, on residues modulo a prime.

With all deltas at random residues, and one of them eps away from there, the equations K s + B u of the
signals have a regular K, and the channels w = eps z of that delta have the LFT

    z = -F_s K^-1 P w + (F_u - F_s K^-1 B) u,      y = -Y_s K^-1 P w + ...

P has the columns of the unit matrix at the equations of the delta, and [F_s, F_u] what is multiplied with
it there. The McMillan degree is the bound (`mbdlft/order/lower_bound.py`). K^-1 is a product of sparse
triangular matrices, with the pivots of doubles; columns are solved for together, level by level, as the
rows of a level need those of earlier ones only.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from heapq import heapify, heappop, heappush
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from mbdlft.base.array import Array
from mbdlft.base.errors import WellPosednessError
from mbdlft.exact.modular import MOST_SUMMED, Residues, entrywise, joined, limbs, reduced_sizes
from mbdlft.lft.sparse import ALWAYS, SparseLFT, factors_of, matrix_at

_MOST_COLUMNS = 128  # that are solved for together, if they are of several deltas
Rows = list[dict[int, int]]


@dataclass(frozen=True, slots=True, eq=False)
class SparseResidues:
    """A sparse LFT, and its entries as residues."""

    lft: SparseLFT
    entries: Residues
    prime: int


class _AtRandom(NamedTuple):
    """The equations at random residues of the deltas."""

    E: csr_array  # [K, B ; Y, D]
    inverse: "_Inverse"
    solved: Residues  # K^-1 B


@lru_cache(maxsize=1)  # zeros and degrees of the same LFT are asked for one after the other
def _at_random(a: SparseResidues, seed: int) -> _AtRandom:
    lft, prime, n = a.lft, a.prime, a.lft.signals
    random = np.random.default_rng(seed)
    at = random.integers(1, prime, len(lft.blocks), dtype=np.int64)
    at = np.append(at, 1)  # the last is that of -1
    E = _matrix(lft, entrywise(a.entries, at[lft.block], prime), prime)
    inverse = _Inverse(E[:n, :n], lft, random.uniform(-0.5, 0.5, len(lft.blocks)), prime)
    return _AtRandom(E, inverse, inverse.times(E[:n, n:].toarray()))


def value_at_random(a: SparseResidues, seed: int = 0) -> Residues:
    """The value (outputs, inputs) at random residues."""
    n, (E, _, solved) = a.lft.signals, _at_random(a, seed)
    value = E[n:, n:].toarray() - _times(E[n:, :n], solved, a.prime)
    return np.asarray(value % a.prime)


def sparse_degrees(a: SparseResidues, seed: int = 0) -> dict[str, int]:
    """Proved minimum of the repetitions of each delta, in any exact LFT of the same matrix."""
    lft, prime, n = a.lft, a.prime, a.lft.signals
    E, inverse, of_inputs = _at_random(a, seed)
    F = _matrix(lft, np.where(lft.block == ALWAYS, 0, a.entries), prime)
    degrees = dict[str, int]()
    for group in _groups(lft):
        rows = np.concatenate([*group.values(), np.zeros(0, dtype=np.int64)])
        P = np.zeros((n, len(rows)), dtype=np.int64)
        P[rows, range(len(rows))] = 1
        of_channels, start = inverse.times(P), 0
        for name, own in group.items():
            size = len(own)
            solved = np.hstack([of_channels[:, start : start + size], of_inputs])
            z = -_times(F[own, :n], solved, prime)
            z[:, size:] += F[own, n:].toarray()
            M = np.vstack([z, -_times(E[n:, :n], solved, prime)]) % prime
            (degrees[name],) = reduced_sizes(M, [size], prime)
            start += size
    return degrees


def _groups(a: SparseLFT) -> list[dict[str, NDArray[np.int64]]]:
    """Equations of each delta by its name, some deltas together."""
    groups, most = [dict[str, NDArray[np.int64]]()], _MOST_COLUMNS
    for k, block in enumerate(a.blocks):
        rows = np.unique(a.row[a.block == k])
        if groups[-1] and sum(map(len, groups[-1].values())) + len(rows) > most:
            groups.append({})
        groups[-1][block.name] = rows
    return groups


def _matrix(a: SparseLFT, entries: Residues, prime: int) -> csr_array:
    """The sparse matrix of some entries of an LFT: at most two of one place, which are added."""
    some, shape = entries != 0, (a.signals + a.shape[0], a.signals + a.shape[1])
    matrix = csr_array((entries[some], (a.row[some], a.column[some])), shape=shape)
    matrix.data %= prime
    return matrix


Limbs = list[csr_array]  # of the entries of a sparse matrix


def _in_limbs(a: csr_array) -> Limbs:
    assert np.max(np.diff(a.indptr), initial=0) <= MOST_SUMMED
    return [csr_array((x, a.indices, a.indptr), shape=a.shape) for x in limbs(a.data)]


def _times(a: csr_array, right: Residues, prime: int) -> Residues:
    """a right (n, m) modulo a prime."""
    used = np.unique(a.indices)
    return joined(_products(_in_limbs(a[:, used]), _side_by_side(right[used])), prime)


def _side_by_side(right: Residues) -> Array:
    """Limbs (n, 3 m) of (n, m)."""
    return limbs(right).transpose(1, 0, 2).reshape(len(right), 3 * right.shape[1])


def _products(a: Limbs, right: Array) -> Residues:
    """Limbs times limbs (n, 3 m): (3, 3, rows, m), sums that are exact doubles."""
    parts = np.array([x @ right for x in a], dtype=np.int64)
    return parts.reshape(3, a[0].shape[0], 3, right.shape[1] // 3).transpose(0, 2, 1, 3)


class _Level(NamedTuple):
    """Rows of a triangular matrix that depend on rows of earlier levels only."""

    rows: NDArray[np.int64]
    entries: Limbs  # (rows, n), beside the diagonal


class _Inverse:
    """K^-1 modulo a prime: K = P_r^-1 L D U P_c^-1, with unit diagonals of L and U."""

    def __init__(self, K: csr_array, a: SparseLFT, deltas: Array, prime: int) -> None:
        n = a.signals
        self.prime = prime
        factors = factors_of(matrix_at(a, deltas)[:n, :n])
        assert factors is not None  # regular at random deltas, as at zero
        self.of_row, of_column = factors.perm_r, factors.perm_c
        moved = K.tocoo()
        rows: Rows = [{} for _ in range(n)]
        places = (self.of_row[moved.row].tolist(), of_column[moved.col].tolist())
        for i, j, x in zip(*places, moved.data.tolist(), strict=True):
            rows[i][j] = x
        below, diagonal, columns = _eliminated(rows, prime)
        self.of_column = np.argsort(columns)[of_column]
        self.diagonal = np.array(diagonal, dtype=np.int64)[:, None]
        first = _levels(below, range(n))
        self.levels, self.below = [*first, *_levels(rows, range(n - 1, -1, -1))], len(first)

    def times(self, right: Residues) -> Residues:
        """K^-1 right (n, m)."""
        x = np.empty_like(right)
        x[self.of_row] = right
        parts = _side_by_side(x)
        for k, (rows, entries) in enumerate(self.levels):
            if k == self.below:
                x = entrywise(x, self.diagonal, self.prime)
                parts = _side_by_side(x)
            x[rows] = (x[rows] - joined(_products(entries, parts), self.prime)) % self.prime
            parts[rows] = _side_by_side(x[rows])
        if self.below == len(self.levels):
            x = entrywise(x, self.diagonal, self.prime)
        return np.asarray(x[self.of_column])


def _eliminated(rows: Rows, prime: int) -> tuple[Rows, list[int], list[int]]:
    """L beside its diagonal, inverses of pivots, and the order of columns; rows become those of U.

    A pivot that doubles have chosen may be nothing but their rounding. It is zero here, and the next
    entry of its row takes its place.
    """
    below: Rows = []
    inverses, columns = list[int](), [*range(len(rows))]
    for i, row in enumerate(rows):
        waiting, left = [j for j in row if j < i], dict[int, int]()
        heapify(waiting)
        while waiting:
            j = heappop(waiting)
            factor = row.pop(j, 0)
            if not factor:
                continue
            # row j of U is divided by its pivot, so this is L times that pivot
            for k, x in rows[j].items():
                if k < i and k not in row:
                    heappush(waiting, k)
                row[k] = (row.get(k, 0) - factor * x) % prime
            left[j] = factor * inverses[j] % prime
        below.append(left)
        if not row.get(i):
            other = next((k for k, x in row.items() if x), None)
            if other is None:
                raise WellPosednessError(
                    "the equations are singular at all values: their determinant is zero in exact "
                    "numbers, though it is not in doubles."
                )
            _exchange(rows, i, other)
            columns[i], columns[other] = columns[other], columns[i]
        inverses.append(pow(row.pop(i), -1, prime))
        rows[i] = {k: x * inverses[i] % prime for k, x in row.items() if x}
    return below, inverses, columns


def _exchange(rows: Rows, i: int, k: int) -> None:
    """Exchange two columns, in place."""
    for row in rows:
        if i in row or k in row:
            row[i], row[k] = row.get(k, 0), row.get(i, 0)


def _levels(rows: Rows, order: Sequence[int]) -> list[_Level]:
    """Rows of a triangular matrix by how many others they wait for; without those that need none."""
    depth = dict[int, int]()
    by_depth: dict[int, list[int]] = {}
    for i in order:
        depth[i] = 1 + max((depth[j] for j in rows[i]), default=-1)
        if depth[i]:
            by_depth.setdefault(depth[i], []).append(i)
    levels = []
    for _, some in sorted(by_depth.items()):
        ends = np.cumsum([0, *(len(rows[i]) for i in some)])
        columns = np.array([j for i in some for j in rows[i]], dtype=np.int64)
        data = np.array([x for i in some for x in rows[i].values()], dtype=np.int64)
        entries = csr_array((data, columns, ends), shape=(len(some), len(rows)))
        levels.append(_Level(np.array(some), _in_limbs(entries)))
    return levels
