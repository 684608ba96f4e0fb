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


def remove_creep_of_held(
    signal: FloatArray, creep: CreepDynamics, sample_period_s: float,
) -> FloatArray:
    """Return the input, held for a sample period each, to which the creep answers with a signal.

    Each sample of the signal is the answer at the end of its hold.

    Parameters
    ----------
    signal : ndarray, shape (N,)
    creep : CreepDynamics
        If one of its exponentials goes backwards, as no material does, or two of its poles are
        equal, `remove_creep` does it.
    sample_period_s : float
        Of any length.

    Returns
    -------
    ndarray, shape (N,)
        Begins in equilibrium with the first sample.
    """
    rates, zeros = np.array(creep.poles_rad_per_s), np.array(creep.zeros_rad_per_s)
    apart = rates[None, :] - rates[:, None] + np.eye(rates.size)
    if not np.all(apart):
        return remove_creep(signal, creep, sample_period_s)
    gains = np.prod((zeros[None, :] - rates[:, None]) / apart, axis=1) / rates
    if np.any(gains < 0.0):
        return remove_creep(signal, creep, sample_period_s)
    decays = np.exp(-rates * sample_period_s)
    return input_of_creep(signal, rates, gains, sample_period_s, decays)


def input_of_creep(
    signal: FloatArray, rates: FloatArray, gains: FloatArray, sample_period_s: float,
    unanswered: FloatArray,
) -> FloatArray:
    """Return the input, held for a sample period each, of a signal that exponentials crept behind.

    Parameters
    ----------
    signal : ndarray, shape (N,)
    rates, gains, unanswered : ndarray, shape (P,)
        As of `inverse_of_creep`.

    Returns
    -------
    ndarray, shape (N,)
        Begins in equilibrium with the first sample.
    """
    at_once, forgotten, weights = inverse_of_creep(rates, gains, sample_period_s, unanswered)
    moved = signal - signal[0]
    rest = moved.copy()
    for rate, weight in zip(forgotten, weights, strict=True):
        rest -= lfilter([0.0, weight], [1.0, rate - 1.0], moved)
    held: FloatArray = rest / at_once + signal[0] / (1.0 + gains.sum())
    return held


def inverse_of_creep(
    rates: FloatArray, gains: FloatArray, sample_period_s: float, unanswered: FloatArray,
) -> tuple[float, FloatArray, FloatArray]:
    """Return the inverse of exponentials that creep behind a held input, as a sum of such.

    An exponential has come to x when a hold of h begins, and answers in it with x m + h (1 - m).
    With the states x[n+1] = a x[n] + b h[n] the signal is y[n] = b' x[n] + d h[n], with diagonal a.
    That of the inverse, a - b b' / d, is symmetric, so that it is a sum of exponentials, too. One
    filter of high order would lose all digits, as all poles are near 1.

    Parameters
    ----------
    rates, gains : ndarray, shape (P,)
        Of creep 1 + sum g p / (s + p): rates p in rad/s, and gains g, none of them negative.
    unanswered : ndarray, shape (P,)
        Part m of a step of the input by which each is still behind in the signal of that sample.

    Returns
    -------
    at_once : float
        The direct part d.
    forgotten, weights : ndarray, shape (P,)
        The input is y[n] less the sums of weight y[m] (1 - forgotten)^(n - 1 - m) over all m < n,
        over d.
    """
    gone = -np.expm1(-rates * sample_period_s)
    at_once = float(1.0 + gains @ (1.0 - unanswered))
    coupling = np.sqrt(gains * unanswered * gone)
    forgotten, turned = np.linalg.eigh(np.diag(gone) + np.outer(coupling, coupling) / at_once)
    return at_once, forgotten, (coupling @ turned) ** 2 / at_once
