"""The array that nearly everything here is: of floating-point numbers, its shape in the
docstrings."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
