"""Linear equations in doubles: dense matrices of several points, or sparse ones, one of each point.

Equations of models have a few entries each, however many there are: n of them take time n^3 and memory
n^2 at each point as dense matrices.
"""

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np
from scipy.sparse import block_array, csc_array, eye_array, issparse

from mbdlft.base.array import Array

LARGE = 150  # equations up to which dense matrices take less time
TOGETHER = 16  # points, of dense matrices at a time
_ROUNDS = 2  # of scaling of rows and columns
_DAMPING, _REFINED = 1e-12, 3  # of squares of singular values; rounds, in which 1e-5 has all digits

Matrices = Any  # Array (N, n, m), or csc_array (n, m)


class Entries:
    """Where the entries (k,) of a matrix (n, m) are that are not always zero, by columns as in CasADi."""

    def __init__(self, pattern: ca.Sparsity) -> None:
        self.shape: tuple[int, int] = pattern.shape
        self.rows, self.columns = (np.array(k, dtype=np.int32) for k in pattern.get_triplet())
        self._starts = np.array(pattern.colind(), dtype=np.int32)
        self.is_large = min(self.shape) > LARGE

    def matrix(self, entries: Array) -> Matrices:
        """The matrix of entries (k,): a dense one (n, m) if it is not large."""
        if self.is_large:
            return csc_array((entries, self.rows, self._starts), shape=self.shape)
        return self.dense(entries)

    def dense(self, entries: Array) -> Array:
        """Matrices (..., n, m) of entries (..., k)."""
        matrices = np.zeros((*entries.shape[:-1], *self.shape))
        matrices[..., self.rows, self.columns] = entries
        return matrices

    def parts(self, entries: Array) -> list[Matrices]:
        """Matrices of entries (N, k): stacks of dense ones, or sparse ones, one of each point."""
        if self.is_large:
            return [self.matrix(row) for row in entries]
        return [self.dense(entries[k : k + TOGETHER]) for k in range(0, len(entries), TOGETHER)]


def joined(arrays: Sequence[Any], ndim: int = 3) -> Any:
    """Results (N, ...) of the `parts`, of which those of sparse matrices are of one point."""
    return np.concatenate([a if a.ndim == ndim else a[None] for a in arrays])


def dense(K: Matrices) -> Any:
    """The dense matrix or matrices."""
    return K.toarray() if issparse(K) else K


def solve(K: Matrices, right: Matrices) -> Any:
    """K^-1 right, dense; a LinAlgError if K is singular."""
    if isinstance(K, csc_array) and K.nnz:
        return solve_scaled(K, right)
    return np.linalg.solve(dense(K), dense(right))


def solve_scaled(K: Matrices, right: Matrices) -> Any:
    """The same, with rows and columns of K times powers of two that make them of one size."""
    if isinstance(K, csc_array):
        of_column = np.repeat(np.arange(K.shape[1]), np.diff(K.indptr))
        rows, columns, sizes = np.ones(K.shape[0]), np.ones(K.shape[1]), np.abs(K.data)
        for _ in range(_ROUNDS):
            for factors, places in ((rows, K.indices), (columns, of_column)):
                largest = np.zeros(len(factors))
                np.maximum.at(largest, places, sizes * rows[K.indices] * columns[of_column])
                factors *= _power(largest)
        entries = K.data * rows[K.indices] * columns[of_column]
        factored = _factors(csc_array((entries, K.indices, K.indptr), shape=K.shape))
        return factored.solve(dense(right) * rows[:, None]) * columns[:, None]
    rows, columns = np.ones((*K.shape[:-1], 1)), np.ones((*K.shape[:-2], 1, K.shape[-1]))
    for _ in range(_ROUNDS):
        rows = rows * _power(np.max(np.abs(K) * rows * columns, axis=-1, keepdims=True))
        columns = columns * _power(np.max(np.abs(K) * rows * columns, axis=-2, keepdims=True))
    return np.linalg.solve(K * rows * columns, right * rows) * columns.swapaxes(-1, -2)


def smallest(J: csc_array, right: Array) -> Array:
    """The smallest x (n, ...) with J x = right (m, ...), whose equations may depend on each other.

    It is J' y with (J J' + a) y = right, a small, refined; what no x gives stays missed. Singular values
    far below 1e-6 count as zero, so rows and columns of J are to be of size 1.
    """
    m, n = J.shape
    whole = block_array([[eye_array(n), J.T], [J, -_DAMPING * eye_array(m)]], format="csc")
    factors, x, missed = _factors(whole), np.zeros((n, *right.shape[1:])), right
    for _ in range(_REFINED):
        x = x + factors.solve(np.concatenate([np.zeros_like(x), missed]))[:n]
        missed = right - J @ x
    return x


def pseudo_inverse(J: Matrices, sizes: Array) -> tuple[Array, Array]:
    """That of J (m, n) with columns times their sizes (n,) and rows over their norms (m,); the norms."""
    scaled = J.multiply(sizes[None]).tocsc() if issparse(J) else J * sizes
    norms = np.sqrt((abs(scaled) ** 2).sum(axis=1))
    norms[norms == 0.0] = 1.0
    if issparse(J):
        return smallest(scaled.multiply(1.0 / norms[:, None]).tocsc(), np.eye(len(norms))), norms
    return np.linalg.pinv(scaled / norms[:, None]), norms


def _factors(K: csc_array) -> Any:
    from scipy.sparse.linalg import splu  # here because it is slow to import

    try:
        return splu(K)
    except RuntimeError as error:
        raise np.linalg.LinAlgError(str(error)) from None


def _power(size: Array) -> Array:
    """The power of two that makes a size about 1; 1 for zero."""
    exponent = np.frexp(np.where(size > 0.0, size, 0.5))[1]
    return np.ldexp(1.0, -exponent)
