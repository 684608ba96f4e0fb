# SPDX-License-Identifier: BSD-3-Clause
"""Ways in which the first voltage of a recording may have been reached."""

import numpy as np

from piezo_common.arrays import FloatArray

PASTS = ("rising", "falling", "demagnetised")
"""From the lowest voltage, from the highest, or by swings of decreasing amplitude."""

SWINGS = 40
"""Number of swings of a demagnetising voltage."""


def past_voltages(past: str, first_v: float, low_v: float, high_v: float) -> FloatArray:
    """Return extremes of the voltage before a recording, (K,), for one of `PASTS`.

    The recording begins with the first voltage; the others are the range of the voltage.
    """
    if past == "rising":
        return np.array([low_v])
    if past == "falling":
        return np.array([low_v, high_v])
    part = 1.0 - np.arange(SWINGS) / SWINGS
    return first_v + part * np.where(np.arange(SWINGS) % 2, high_v - first_v, low_v - first_v)
