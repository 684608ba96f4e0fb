# SPDX-License-Identifier: BSD-3-Clause
"""Types of arrays in annotations."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
"""Array of real numbers."""

ComplexArray = NDArray[np.complex128]
"""Array of complex numbers, such as a response over frequency."""

BoolArray = NDArray[np.bool_]
"""Array of truth values, such as which samples are good."""

IntArray = NDArray[np.int_]
"""Array of whole numbers, such as positions or lines of a spectrum."""
