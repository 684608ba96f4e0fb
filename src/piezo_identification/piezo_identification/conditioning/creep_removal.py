# SPDX-License-Identifier: BSD-3-Clause
"""Remove the creep from a measured signal before faster components are estimated."""

import numpy as np
from scipy.linalg import eigh
from scipy.signal import lfilter, lfilter_zi

from piezo_common.arrays import FloatArray
from piezo_models.linear.dynamics import CreepDynamics


def remove_creep(signal: FloatArray, creep: CreepDynamics, sample_period_s: float) -> FloatArray:
    """Pass a uniformly sampled signal, (N,), through the inverse of the creep, Fig. 4.7.

    The sample period is short compared with the creep: the signal is assumed linear between samples
    (bilinear rule). The result begins in equilibrium with the first sample.
    """
    for pole, zero in zip(creep.poles_rad_per_s, creep.zeros_rad_per_s, strict=True):
        halves = 0.5 * sample_period_s * np.array([pole, zero])
        numerator = np.array([1.0 + halves[0], halves[0] - 1.0]) / (1.0 + halves[1])
        denominator = np.array([1.0, (halves[1] - 1.0) / (1.0 + halves[1])])
        initial = lfilter_zi(numerator, denominator) * signal[0]
        signal = lfilter(numerator, denominator, signal, zi=initial)[0]
    return signal


def remove_creep_of_held(
    signal: FloatArray, creep: CreepDynamics, sample_period_s: float,
) -> FloatArray:
    """Return the held input, (N,), whose response, including the creep, is the given signal.

    Each sample of the signal is the response at the end of its hold, of any length. The input
    begins in equilibrium with the first sample. If the creep has an exponential with negative gain,
    as no material does, or two equal poles, `remove_creep` is used instead.
    """
    rates, zeros = np.array(creep.poles_rad_per_s), np.array(creep.zeros_rad_per_s)
    apart = rates[None, :] - rates[:, None] + np.eye(rates.size)
    if not np.all(apart):
        return remove_creep(signal, creep, sample_period_s)
    gains = np.prod((zeros[None, :] - rates[:, None]) / apart, axis=1) / rates
    if np.any(gains < 0.0):
        return remove_creep(signal, creep, sample_period_s)
    at_once, forgotten, weights = inverse_of_creep(
        rates, gains, sample_period_s, np.exp(-rates * sample_period_s))
    moved = signal - signal[0]
    rest = moved.copy()
    for rate, weight in zip(forgotten, weights, strict=True):
        rest -= lfilter([0.0, weight], [1.0, rate - 1.0], moved)
    held: FloatArray = rest / at_once + signal[0] / (1.0 + gains.sum())
    return held


def inverse_of_creep(
    rates: FloatArray, gains: FloatArray, sample_period_s: float, unanswered: FloatArray,
) -> tuple[float, FloatArray, FloatArray]:
    """Return the inverse of the response of creep to a held input, as a sum of exponentials.

    An exponential with the state x at the beginning of a hold h contributes x m + h (1 - m). With
    the states x[n+1] = a x[n] + b h[n], the signal is y[n] = b' x[n] + d h[n], with diagonal a. The
    state matrix of the inverse, a - b b' / d, is symmetric, so the inverse is also a sum of
    exponentials. A single filter of high order would lose all digits, as all poles are near 1.

    The creep is 1 + sum g p / (s + p), with rates p in rad/s and gains g, (P,), none of which is
    negative. `unanswered`, (P,), is the fraction m of a step of the input that each exponential
    still lacks in the same sample. Returned are the direct feedthrough d, and decay (`forgotten`)
    and weight of each exponential, (P,): the input is y[n] less the sums of weight y[m] (1 -
    forgotten)^(n - 1 - m) over all m < n, divided by d.
    """
    gone = -np.expm1(-rates * sample_period_s)
    at_once = float(1.0 + gains @ (1.0 - unanswered))
    coupling = np.sqrt(gains * unanswered * gone)
    forgotten, turned = eigh(np.diag(gone) + np.outer(coupling, coupling) / at_once)
    return at_once, forgotten, (coupling @ turned) ** 2 / at_once
