"""Matrices of balls (python-flint): doubles are exact in them, and each result contains the true one."""

from collections.abc import Sequence
from typing import Any

import flint
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.exact.matrices import entries_of, middles_of

entries = entries_of  # of a matrix of balls (rows, columns)


def balls(a: NDArray[Any]) -> Any:
    """A matrix of doubles, real or complex, as exact balls."""
    kind = flint.acb_mat if np.iscomplexobj(a) else flint.arb_mat
    rows, columns = a.shape
    return kind(rows, columns, a.ravel().tolist())


def joined(blocks: Sequence[Sequence[NDArray[Any]]]) -> Any:
    """A complex matrix of balls of blocks of doubles and of entries."""
    whole = np.block([[block.astype(object) for block in row] for row in blocks])
    rows, columns = whole.shape
    return flint.acb_mat(rows, columns, whole.ravel().tolist())


def largest(matrix: Any) -> Array:
    """Upper bounds of the sizes of all entries (rows, columns): doubles, rounded upward."""
    sizes = np.array([float(abs(x).upper()) for x in matrix.entries()])
    return np.asarray(np.nextafter(sizes, np.inf).reshape(matrix.nrows(), matrix.ncols()))


def is_positive(matrix: Any) -> bool:
    """Whether a Hermitian matrix of balls is positive definite: L M L* is dominated by its diagonal.

    L is the inverse of a factor in doubles; it may be anything.
    """
    middle = middles_of(matrix)
    diagonal = np.diagonal(middle).real
    if not np.all(diagonal > 0.0):
        return False
    scale = 2.0 ** np.round(-0.5 * np.log2(diagonal))
    try:
        factor = np.linalg.cholesky(scale[:, None] * middle * scale)
        L = balls(np.linalg.inv(factor) * scale)
    except np.linalg.LinAlgError:
        return False
    near_one = L * matrix * adjoint(L)
    for i in range(len(middle)):
        others = sum((abs(near_one[i, j]) for j in range(len(middle)) if j != i), flint.arb(0))
        if not near_one[i, i].real > others:
            return False
    return True


def adjoint(matrix: Any) -> Any:
    """The conjugate transpose."""
    return (matrix.conjugate() if isinstance(matrix, flint.acb_mat) else matrix).transpose()
