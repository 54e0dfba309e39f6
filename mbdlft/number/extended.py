"""Linear algebra in extended precision, for a few hundred rows.

numpy's `longdouble` has 64 bits of mantissa on most machines, and no LAPACK behind it.
"""

import numpy as np
from numpy.typing import NDArray

Extended = NDArray[np.longdouble]
IS_EXTENDED = bool(np.finfo(np.longdouble).eps < np.finfo(float).eps)  # not on every machine


def orthonormal_columns(columns: Extended, least: float, most: int) -> tuple[Extended, list[float]]:
    """Orthonormal vectors of the directions of columns (n, m) with lengths above `least`.

    Gram and Schmidt with pivots, every projection taken twice.

    Returns
    -------
    vectors (n, count), at most `most` of them; their lengths when they were taken, the longest first
    """
    found: list[Extended] = []
    lengths: list[float] = []
    rest = columns.copy()
    while len(found) < most:
        sizes = np.sum(rest * rest, axis=0)
        pivot = int(np.argmax(sizes))
        length = float(np.sqrt(sizes[pivot]))
        if not length > least:
            break
        vector = rest[:, pivot] / np.sqrt(sizes[pivot])
        for other in found:
            vector = vector - other * (other @ vector)
        vector = vector / np.sqrt(vector @ vector)
        for _ in range(2):
            rest = rest - np.outer(vector, vector @ rest)
        found.append(vector)
        lengths.append(length)
    return np.stack(found, axis=1) if found else columns[:, :0], lengths


def over_rows(basis: Extended, rows: NDArray[np.int64]) -> Extended:
    """basis basis[rows]^-1 (n, m): the basis (n, m) of the same space that is the identity in m rows."""
    found = basis.copy()
    for k, row in enumerate(rows):
        pivot = k + int(np.argmax(np.abs(found[row, k:])))
        found[:, [k, pivot]] = found[:, [pivot, k]]
        found[:, k] = found[:, k] / found[row, k]
        others = [j for j in range(found.shape[1]) if j != k]
        found[:, others] = found[:, others] - np.outer(found[:, k], found[row, others])
    return found
