# SPDX-License-Identifier: BSD-3-Clause
"""Levels of a digital-to-analogue or analogue-to-digital converter."""

import numpy as np
from numba import njit


@njit(cache=True)
def quantise(value, low, step, levels):
    """Nearest of the levels low + k step, k = 0..levels - 1."""
    level = np.rint((value - low) / step)
    return low + step * min(max(level, 0.0), levels - 1.0)
