# SPDX-License-Identifier: BSD-3-Clause
"""Ways by which the first voltage of a recording may have been reached."""

import numpy as np

from piezo_common.arrays import FloatArray

PASTS = ("rising", "falling", "demagnetised")
"""From the lowest voltage, from the highest, or in swings that became smaller and smaller."""

SWINGS = 40
"""A voltage that demagnetises swings so often."""


def past_voltages(past: str, first_v: float, low_v: float, high_v: float) -> FloatArray:
    """Return extremes of the voltage before a recording.

    Parameters
    ----------
    past : str
        One of `PASTS`.
    first_v : float
        Voltage with which the recording begins.
    low_v, high_v : float
        Between which the voltage goes.

    Returns
    -------
    ndarray, shape (K,)
    """
    if past == "rising":
        return np.array([low_v])
    if past == "falling":
        return np.array([low_v, high_v])
    part = 1.0 - np.arange(SWINGS) / SWINGS
    return first_v + part * np.where(np.arange(SWINGS) % 2, high_v - first_v, low_v - first_v)
