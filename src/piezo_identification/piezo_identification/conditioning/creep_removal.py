# SPDX-License-Identifier: BSD-3-Clause
"""The creep taken out of a measured signal, before anything that is faster is estimated."""

import numpy as np
from scipy.signal import lfilter, lfilter_zi

from piezo_common.arrays import FloatArray
from piezo_models.linear.dynamics import CreepDynamics


def remove_creep(signal: FloatArray, creep: CreepDynamics, sample_period_s: float) -> FloatArray:
    """Pass a uniformly sampled signal through the inverse of the creep, Fig. 4.7.

    Parameters
    ----------
    signal : ndarray, shape (N,)
    creep : CreepDynamics
    sample_period_s : float
        Short beside the creep; the signal is taken for linear between samples (bilinear rule).

    Returns
    -------
    ndarray, shape (N,)
        Begins in equilibrium with the first sample.
    """
    for pole, zero in zip(creep.poles_rad_per_s, creep.zeros_rad_per_s, strict=True):
        halves = 0.5 * sample_period_s * np.array([pole, zero])
        numerator = np.array([1.0 + halves[0], halves[0] - 1.0]) / (1.0 + halves[1])
        denominator = np.array([1.0, (halves[1] - 1.0) / (1.0 + halves[1])])
        initial = lfilter_zi(numerator, denominator) * signal[0]
        signal = lfilter(numerator, denominator, signal, zi=initial)[0]
    return signal
