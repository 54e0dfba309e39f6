"""The array type that annotations name most often."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
