# SPDX-License-Identifier: BSD-3-Clause
"""The smooth rise of all transitions, of the reference and of the voltage."""

import numpy as np
from numpy.typing import ArrayLike

from piezo_common.arrays import FloatArray


def minimum_jerk(count: int) -> FloatArray:
    """Rise smoothly from 0 towards 1, which would be reached by the sample after the last.

    The quintic has zero speed and acceleration at its ends, so it excites no vibration.
    """
    return smooth_rise(np.arange(count) / count)


def smooth_rise(share: ArrayLike) -> FloatArray:
    """Evaluate the quintic of `minimum_jerk` at parts of its duration: 0 before 0, 1 after 1."""
    t = np.clip(share, 0.0, 1.0)
    return t**3 * (10 - 15 * t + 6 * t**2)
