# SPDX-License-Identifier: BSD-3-Clause
"""Ways in which the first voltage of a recording may have been reached."""

import numpy as np

from piezo_common.arrays import FloatArray

PASTS = ("rising", "falling", "demagnetised")
"""From the lowest voltage, from the highest, or by swings of decreasing amplitude."""

SWINGS = 100
"""Number of swings of a demagnetising voltage."""


def past_voltages(past: str, first_v: float, low_v: float, high_v: float) -> FloatArray:
    """Return extremes of the voltage before a recording, (K,), for one of `PASTS`.

    The recording begins with the first voltage; the others are the range of the voltage.
    """
    if past == "rising":
        return np.array([low_v])
    if past == "falling":
        return np.array([low_v, high_v])
    return demagnetising_v(first_v, low_v, high_v)


def demagnetising_v(centre_v: float, low_v: float, high_v: float) -> FloatArray:
    """Return the extremes of swings about a voltage that become smaller, within a range, (K,).

    Plays are then in the middle of their widths, as those of a simulated stage usually begin.
    """
    largest_v = max(high_v - centre_v, centre_v - low_v)
    swings_v = largest_v * (1.0 - np.arange(SWINGS) / SWINGS) * (-1.0) ** np.arange(SWINGS)
    return np.clip(centre_v + swings_v, low_v, high_v)
