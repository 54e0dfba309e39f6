"""Rounding: what is left of terms that cancelled is set to zero, so that it is not taken for structure.

Every sum or solution comes with the size that it would have if nothing cancelled; an entry far below
that size is rounding.
"""

from typing import Any

import numpy as np

from mbdlft.base.array import Array

ROUNDING = 2.0**-50  # what is dropped is no more than rounding can have made
NOISE = 2.0**-44  # part of its terms below which an entry may be nothing but rounding


def cleaned(values: Array, size: Array) -> Array:
    """Values with the entries that are rounding of terms of a size set to zero; same shapes."""
    return np.where(np.abs(values) <= ROUNDING * size, 0.0, values)


def product(left: Array, right: Array) -> Array:
    """left @ right, cleaned."""
    return cleaned(left @ right, np.abs(left) @ np.abs(right))


def solution_size(inverse: Array, matrix: Any, solution: Array, right: Array) -> Array:
    """Size of the terms of matrix^-1 right: |matrix^-1| (|matrix| |solution| + |right|).

    `matrix` may be sparse.
    """
    terms: Array = abs(matrix) @ np.abs(solution) + np.abs(right)
    return np.asarray(np.abs(inverse) @ terms)


def conditioning(values: Array, sizes: Array, scale: Array, least: Array) -> tuple[float, int]:
    """How much rounding of the data changes entries relative to themselves, and where that means little.

    Parameters
    ----------
    values : array (N, ., .)
        At N values of the parameters.
    sizes : array (N, ., .)
        If nothing cancelled.
    scale : array (., .)
        The largest sizes of the entries; where one is larger than that, the entry is negligible.
    least : array (., .)
        A smaller value at one of the points is negligible there.

    Returns
    -------
    float
        Largest size relative to the entry itself; relative to `scale` for entries that are negligible or
        change their sign. At least 1.
    int
        Number of entries that change their sign, or vanish at some of the points.
    """
    parts = np.abs(values)
    clear = parts > NOISE * sizes
    some, everywhere = np.any(clear, axis=0), np.all(clear, axis=0)
    one_sign = everywhere & (np.all(values > 0.0, axis=0) | np.all(values < 0.0, axis=0))
    counts = np.max(parts, axis=0, initial=0.0) >= scale
    itself = np.maximum(np.where(clear, parts, 1.0), least)
    condition = np.max((sizes / np.where(one_sign & counts, itself, scale))[:, some], initial=1.0)
    return float(condition), int(np.sum(some & ~one_sign & counts))
