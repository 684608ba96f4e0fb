# SPDX-License-Identifier: BSD-3-Clause
"""The creep taken out of a measured signal, before anything that is faster is estimated."""

import numpy as np
from scipy.signal import lfilter, lfilter_zi

from piezo_common.arrays import FloatArray
from piezo_models.linear.dynamics import CreepDynamics, zoh


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


def remove_held_creep(
    signal: FloatArray, creep: CreepDynamics, sample_period_s: float,
) -> FloatArray:
    """Pass a signal through the inverse of the creep of an input that is held between samples.

    Parameters
    ----------
    signal : ndarray, shape (N,)
        At the end of each hold.
    creep : CreepDynamics
        May be faster than the samples.
    sample_period_s : float

    Returns
    -------
    ndarray, shape (N,)
        What was held up to each sample; begins in equilibrium with the first one.
    """
    if not creep.poles_rad_per_s:
        return signal
    system = zoh(creep.state_space(), sample_period_s)
    at_rest = np.linalg.solve(np.eye(system.nstates) - system.A, system.B[:, 0])
    output, at_once = system.C[0], system.D[0, 0]
    held = np.empty(signal.size)
    held[0] = signal[0] / (output @ at_rest + at_once)
    state = held[0] * at_rest
    for number in range(1, signal.size):
        decayed = system.A @ state
        held[number] = (signal[number] - output @ decayed) / (
            output @ system.B[:, 0] + at_once)
        state = decayed + system.B[:, 0] * held[number]
    return held
