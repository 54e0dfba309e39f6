"""The array types that annotations name most often; as names, they are short in `help()`."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike as ArrayLike
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
else:

    class Array:
        """A numpy array of doubles."""

    class ArrayLike:
        """A number, a sequence of numbers, sequences of such, or an array."""
