"""Sizes of the rows and columns of matrices."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array


def equilibrate(values: NDArray[Any]) -> tuple[Array, Array]:
    """Factors of rows and columns that bring the largest entries to one."""
    size = np.max(np.abs(values), axis=0, initial=0.0)
    rows = 1.0 / or_one(np.max(size, axis=1, initial=0.0))
    return rows, 1.0 / or_one(np.max(size * rows[:, None], axis=0, initial=0.0))


def or_one(size: Array) -> Array:
    """Sizes to divide by: 1 for zero."""
    return np.where(size > 0.0, size, 1.0)
