"""The types of arrays; docstrings state their shapes."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]  # which of several
Indices = NDArray[np.intp]  # places of several
