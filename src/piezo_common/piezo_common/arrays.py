# SPDX-License-Identifier: BSD-3-Clause
"""Types of arrays in annotations."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
"""Array of real numbers."""

ComplexArray = NDArray[np.complex128]
"""Array of complex numbers, for example a response over frequency."""

BoolArray = NDArray[np.bool_]
"""Array of booleans, for example a mask of good samples."""

IntArray = NDArray[np.int_]
"""Array of integers, for example indices or lines of a spectrum."""
