"""The type of arrays of floating-point numbers; docstrings state their shapes."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
