"""Linear algebra modulo a prime below 2^61: products, elimination, and subspaces that LFTs reach.

Integers of 64 bits and doubles make products; FLINT eliminates. What a thread does here is counted, as
operations of `mbdlft.order.work`: it is the same on every machine.
"""

import threading
from collections.abc import Sequence
from itertools import accumulate, pairwise
from typing import Any

import flint
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array

Residues = NDArray[np.int64]

_LIMB, MOST_SUMMED = 21, 2047  # bits, and how many products of them have a sum that a double holds
_HALF = 31  # bits: a product of a residue with so many has a quotient by the prime that doubles know
_MOST_OF_HALVES = 500  # products, of whose sum they know it, too
_MANY = 300_000  # products, of which BLAS makes those of doubles in less time


# operations of a call, of an entry that FLINT gets, and of a product: 40 us, 0.2 us and 0.9 ns
_OF_CALL, _OF_ENTRY, _OF_PRODUCT = 6e5, 3e3, 13.0


class _Done(threading.local):
    """Operations of this thread."""

    operations = 0.0


done = _Done()


def multiplied(a: Residues, b: Residues, prime: int) -> Residues:
    """a b modulo a prime below 2^61, also of stacks."""
    inner = a.shape[-1]
    done.operations += _OF_CALL + _OF_PRODUCT * a.size * b.shape[-1]
    if inner > MOST_SUMMED:
        half = inner // 2
        first = multiplied(a[..., :half], b[..., :half, :], prime)
        return np.asarray((first + multiplied(a[..., half:], b[..., half:, :], prime)) % prime)
    if a.size * b.shape[-1] > _MANY or inner > _MOST_OF_HALVES:
        # x y' + y x' = x x' + y y' - (x - y) (x' - y'), whose factors are no larger: 6 products for 9
        x, y, z, xy, xz, yz = np.matmul(*map(_with_differences, (a, b))).astype(np.int64)
        return _joined((x, x + y - xy, x + y + z - xz, y + z - yz, z), prime)
    # integers overflow: of x b - q p, which is small, the last 64 bits are all. BLAS has no integers
    halves = np.empty((2, *a.shape), dtype=np.int64)
    halves[0], halves[1] = a >> _HALF, a & (2**_HALF - 1)
    quotients = (halves.astype(float) @ (b * (1.0 / prime))).astype(np.int64)
    high, low = halves @ b - quotients * prime
    return np.asarray((_shifted(high, 2**_HALF, prime) + low) % prime)


def _shifted(x: Residues, y: Residues | int, prime: int) -> Residues:
    """x y less a multiple of a prime, below it in size, for y up to 2^31."""
    return np.asarray(x * y - (x * (1.0 / prime) * y).astype(np.int64) * prime)


def limbs(a: Residues) -> Array:
    """Residues as three doubles each, 2^42 x + 2^21 y + z: (3, ...)."""
    mask = 2**_LIMB - 1
    return np.array([a & mask, (a >> _LIMB) & mask, a >> 2 * _LIMB], dtype=float)


def _with_differences(a: Residues) -> Array:
    x, y, z = limbs(a)
    return np.array([x, y, z, x - y, x - z, y - z])


def joined(C: Residues, prime: int) -> Residues:
    """The residue of products C (3, 3, ...) of limbs with limbs."""
    middle = C[0, 2] + C[1, 1] + C[2, 0]
    return _joined((C[0, 0], C[0, 1] + C[1, 0], middle, C[1, 2] + C[2, 1], C[2, 2]), prime)


def _joined(totals: Sequence[Residues], prime: int) -> Residues:
    """The residue of a sum of totals times 1, 2^21, 2^42, ..., each below 2^55 in size.

    Sums stay below 2^62 in size, as 2^21 times one of them is reduced by its quotient.
    """
    *lower, sums = totals
    for total in reversed(lower):
        quotient = (sums * (2.0**_LIMB / prime)).astype(np.int64)
        sums = (sums << _LIMB) - quotient * prime + total
    return np.asarray(sums % prime)


def entrywise(a: Residues, b: Residues, prime: int) -> Residues:
    """Products of entries modulo a prime below 2^61, with the rules of numpy for shapes."""
    high = _shifted(_shifted(a, b >> _HALF, prime), 2**_HALF, prime)
    return np.asarray((high + _shifted(a, b & (2**_HALF - 1), prime)) % prime)


def inverses(a: Residues, prime: int) -> Residues:
    """Of entries (n,), none of them zero, modulo a prime."""
    return np.array([int(1 / flint.nmod(x, prime)) for x in a.tolist()], dtype=np.int64)


def powers_of(points: Residues, count: int, prime: int) -> Residues:
    """(points, count)."""
    powers = np.ones((len(points), count), dtype=np.int64)
    for e in range(1, count):
        powers[:, e] = entrywise(powers[:, e - 1], points, prime)
    return powers


def solved(a: Residues, b: Residues, prime: int) -> Residues:
    """a^-1 b modulo a prime; a ZeroDivisionError if a is singular."""
    if 0 in b.shape:
        return np.zeros(b.shape, dtype=np.int64)
    return _residues(_residue_matrix(a, prime).solve(_residue_matrix(b, prime)))


def resolvents(a: Residues, diagonals: Residues, right: Residues, prime: int) -> Residues:
    """(diagonal - a)^-1 right modulo a prime, for diagonals (N, n); a ZeroDivisionError if singular.

    Right sides are (N, n) or (N, n, columns). One matrix is converted for all, as an entry of FLINT takes
    longer than its elimination.
    """
    n = len(a)
    if not n:
        return np.zeros(right.shape, dtype=np.int64)
    minus, solutions = _residue_matrix(-a % prime, prime), []
    for diagonal, side in zip((diagonals - np.diag(a)) % prime, right, strict=True):
        matrix = flint.nmod_mat(minus)
        for k, x in enumerate(diagonal.tolist()):
            matrix[k, k] = x
        solutions.append(_residues(matrix.solve(_residue_matrix(side.reshape(n, -1), prime))))
    return np.array(solutions).reshape(right.shape)


def rank(a: Residues, prime: int) -> int:
    """The rank modulo a prime."""
    return int(_residue_matrix(a, prime).rank()) if a.size else 0


def null_space(a: Residues, prime: int) -> Residues:
    """Independent columns (columns of a, nullity) that span the null space modulo a prime."""
    rows, pivots = row_echelon(a, prime)
    free = others(pivots, a.shape[1])
    basis = np.zeros((a.shape[1], len(free)), dtype=np.int64)
    basis[free, np.arange(len(free))] = 1
    basis[pivots] = -rows[:, free] % prime
    return basis


def row_echelon(a: Residues, prime: int) -> tuple[Residues, list[int]]:
    """The reduced echelon form of the rows, without rows of zeros, and the columns of its pivots."""
    matrix, pivots = _eliminated(a, prime)
    rows, all_rows = np.zeros((len(pivots), a.shape[1]), dtype=np.int64), range(len(pivots))
    rows[all_rows, pivots] = 1
    # an entry of FLINT takes longer than its elimination: only those are read that may be anything
    free = others(pivots, a.shape[1])
    entries = [[int(matrix[i, j]) if j > pivots[i] else 0 for j in free] for i in all_rows]
    rows[:, free] = np.array(entries, dtype=np.int64).reshape(len(pivots), len(free))
    return rows, pivots


def others(some: Sequence[int], count: int) -> list[int]:
    """Those of so many numbers that are not among some."""
    return [k for k, is_other in enumerate(np.bincount(some, minlength=count) == 0) if is_other]


def pivot_columns(a: Residues, prime: int) -> list[int]:
    """The columns that do not depend on those before them."""
    return _eliminated(a, prime)[1]


def _eliminated(a: Residues, prime: int) -> tuple[Any, list[int]]:
    """The reduced echelon form of FLINT, and the columns of its pivots."""
    if not a.size:
        return None, []
    matrix, count = _residue_matrix(a, prime).rref()
    pivots, column = [], 0
    for row in range(count):
        while not matrix[row, column]:
            column += 1
        pivots.append(column)
        column += 1
    return matrix, pivots


def _residue_matrix(a: Residues, prime: int) -> Any:
    n, m = a.shape
    done.operations += _OF_CALL + _OF_ENTRY * a.size
    # through a matrix of integers: FLINT converts these half as slowly
    return flint.nmod_mat(flint.fmpz_mat(n, m, a.ravel().tolist()), prime)


def _residues(matrix: Any) -> Residues:
    entries = np.array(list(map(int, matrix.entries())), dtype=np.int64)
    return entries.reshape(matrix.nrows(), matrix.ncols())


def parts_of(sizes: Sequence[int]) -> list[slice]:
    """The channels of each delta."""
    return [slice(first, end) for first, end in pairwise([0, *accumulate(sizes)])]


class Space:
    """A growing subspace: its echelon form, the identity in `pivots`; what was `taken` at each step."""

    def __init__(self, size: int, prime: int) -> None:
        self.size, self.prime = size, prime
        self.basis: Residues = np.zeros((0, size), dtype=np.int64)
        self.pivots: list[int] = []
        self.taken: list[list[int]] = []

    @property
    def is_full(self) -> bool:
        """Whether it is the whole space."""
        return len(self.pivots) == self.size

    @property
    def free(self) -> NDArray[np.intp]:
        """The channels that are no pivots."""
        return np.delete(np.arange(self.size), self.pivots)

    def extend(self, candidates: Residues) -> Residues:
        """Add candidates (count, n); the echelon form of what is new."""
        return self._add(self._outside(candidates)[1])

    def take(self, candidates: Residues) -> Residues:
        """Add candidates (count, n); the first of them that are independent."""
        used, outside = self._outside(candidates)
        is_all = len(self._add(outside)) == len(used)
        taken = used if is_all else used[pivot_columns(outside.T, self.prime)]
        self.taken.append(taken.tolist())
        return candidates[taken]

    def _outside(self, candidates: Residues) -> tuple[NDArray[np.intp], Residues]:
        """Which candidates may be new, and these less what is in the space, in its free channels."""
        used = np.flatnonzero(False if self.is_full else candidates.any(axis=1))
        if not (self.pivots and len(used)):
            return used, candidates[used]
        free, candidates = self.free, candidates[used]
        inside = multiplied(candidates[:, self.pivots], self.basis[:, free], self.prime)
        outside = (candidates[:, free] - inside) % self.prime
        some = outside.any(axis=1)
        return used[some], outside[some]

    def _add(self, outside: Residues) -> Residues:
        if not len(outside):
            return np.zeros((0, self.size), dtype=np.int64)
        free = self.free
        rows, pivots = row_echelon(outside, self.prime)
        fresh = np.zeros((len(rows), self.size), dtype=np.int64)
        fresh[:, free] = rows
        if self.pivots:
            known = self.basis[:, free]
            inside = multiplied(known[:, pivots], rows, self.prime)
            self.basis[:, free] = (known - inside) % self.prime
        self.basis = np.vstack([self.basis, fresh])
        self.pivots += free[pivots].tolist()
        return fresh


def reachable_bases(
    M11: Residues, M12: Residues, sizes: list[int], prime: int, *, is_traced: bool = False
) -> list[Space]:
    """The smallest subspaces S_k with range(M12_k) in S_k and M11_kj S_j in S_k.

    Those that are traced know which columns, and which of M11 times these, span them.
    """
    blocks = parts_of(sizes)
    spaces = [Space(size, prime) for size in sizes]
    add = Space.take if is_traced else Space.extend
    fresh = [add(space, M12[block].T) for space, block in zip(spaces, blocks, strict=True)]
    columns: dict[int, tuple[NDArray[np.intp], Residues]] = {}  # of M11', by block: used in many steps
    while sources := [k for k, rows in enumerate(fresh) if len(rows)]:
        if all(space.is_full for space in spaces):
            break
        ends = np.cumsum([0, *(len(fresh[k]) for k in sources)]).tolist()
        candidates = np.zeros((ends[-1], len(M11)), dtype=np.int64)
        for k, (first, end) in zip(sources, pairwise(ends), strict=True):
            if k not in columns:
                used = np.flatnonzero(M11[:, blocks[k]].any(axis=1))
                columns[k] = used, M11[used, blocks[k]].T
            used, read = columns[k]
            candidates[first:end, used] = multiplied(fresh[k], read, prime)
        fresh = [add(space, candidates[:, block]) for space, block in zip(spaces, blocks, strict=True)]
    return spaces


def reduced_residues(M: Residues, sizes: list[int], prime: int) -> tuple[Residues, list[int]]:
    """As `mbdlft.exact.reachable.reduced`, of residues alone."""
    for _ in range(2):
        M, sizes = _restricted(M, sizes, prime)
    return M, sizes


def reduced_sizes(M: Residues, sizes: list[int], prime: int) -> list[int]:
    """The repetitions of `reduced_residues`."""
    M, sizes = _restricted(M, sizes, prime)
    n = sum(sizes)
    return [len(space.pivots) for space in reachable_bases(M[:n, :n], M[:n, n:], sizes, prime)]


def _restricted(M: Residues, sizes: list[int], prime: int) -> tuple[Residues, list[int]]:
    """The transpose of M with each delta restricted to the subspace that it reaches."""
    n, blocks = sum(sizes), parts_of(sizes)
    spaces = reachable_bases(M[:n, :n], M[:n, n:], sizes, prime)
    kept = [block.start + k for block, space in zip(blocks, spaces, strict=True) for k in space.pivots]
    M = M[[*kept, *range(n, len(M))]]
    inner = [_times_basis(M[:, block], space) for block, space in zip(blocks, spaces, strict=True)]
    return np.hstack([*inner, M[:, n:]]).T, [len(space.pivots) for space in spaces]


def _times_basis(columns: Residues, space: Space) -> Residues:
    """Columns (m, n_k) times the basis of a space, most of whose entries are zero."""
    chosen, free = columns[:, space.pivots], space.free
    rest = space.basis[:, free]
    used = rest.any(axis=0)
    if not used.any():
        return chosen
    inside = multiplied(columns[:, free[used]], rest[:, used].T, space.prime)
    return np.asarray((chosen + inside) % space.prime)
