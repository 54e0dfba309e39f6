"""Rounding: what is left of terms that cancelled is set to zero, so that it is not taken for structure.

Every sum or solution comes with the size that it would have if nothing cancelled; an entry far below
that size is rounding.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_ROUNDING = 2.0**-50  # what is dropped is no more than rounding can have made


def cleaned(values: Array, size: Array) -> Array:
    """Values with the entries that are rounding of terms of a size set to zero; same shapes."""
    return np.where(np.abs(values) <= _ROUNDING * size, 0.0, values)


def is_rounding(value: float, size: float) -> bool:
    """Whether one value is rounding of terms of a size."""
    return abs(value) <= _ROUNDING * size


def product(left: Array, right: Array) -> Array:
    """left @ right, cleaned."""
    return cleaned(left @ right, np.abs(left) @ np.abs(right))


def solution_size(inverse: Array, matrix: Any, solution: Array, right: Array) -> Array:
    """Size of the terms of matrix^-1 right: |matrix^-1| (|matrix| |solution| + |right|).

    `matrix` may be sparse.
    """
    terms: Array = abs(matrix) @ np.abs(solution) + np.abs(right)
    return np.asarray(np.abs(inverse) @ terms)
