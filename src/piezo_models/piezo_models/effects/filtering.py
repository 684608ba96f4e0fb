# SPDX-License-Identifier: BSD-3-Clause
"""Linear filters for sampled displacements, taken as straight between samples, not held."""

from collections.abc import Sequence
from functools import lru_cache

import control
import numpy as np
from scipy.signal import cont2discrete, lfilter, lfilter_zi, tf2ss

from piezo_common.arrays import FloatArray

FAR_APART = 0.1
"""Up to this value of T1 T2 / (T1 + T2)^2, partial fractions of two lags lose no digit."""


def filtered(numerator: Sequence[float], denominator: Sequence[float], signal: FloatArray,
             sample_period_s: float, rest: float | None = None) -> FloatArray:
    """Filter a signal, (N,), by a continuous transfer function, from rest at its first value.

    The coefficients are those of the powers of s, the highest first. The signal is taken as
    straight between samples; it may have rested at another level before.
    """
    return _from_rest(numerator, denominator, signal, sample_period_s, rest)[0]


def filtered_on(numerator: Sequence[float], denominator: Sequence[float], signal: FloatArray,
                sample_period_s: float, state: FloatArray | None = None,
                ) -> tuple[FloatArray, FloatArray]:
    """Filter the next part of a signal as `filtered`, and return the state after it, (n,).

    Without the state after the previous part, it begins from rest at the first value.
    """
    if state is None:
        return _from_rest(numerator, denominator, signal, sample_period_s)
    b, a, _ = _discrete(tuple(numerator), tuple(denominator), sample_period_s)
    return lfilter(b, a, signal, zi=state)


def _from_rest(numerator: Sequence[float], denominator: Sequence[float], signal: FloatArray,
               sample_period_s: float, rest: float | None = None,
               ) -> tuple[FloatArray, FloatArray]:
    b, a, settled = _discrete(tuple(numerator), tuple(denominator), sample_period_s)
    rest = float(signal[0]) if rest is None else rest
    return lfilter(b, a, signal, zi=settled * rest)


@lru_cache(maxsize=2048)
def _discrete(numerator: tuple[float, ...], denominator: tuple[float, ...],
              sample_period_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return coefficients, and the settled state for a level of 1; cached, as a scan repeats."""
    lags_s = _lags(numerator, denominator)
    if lags_s is not None:
        b, a = _two_lags(*lags_s, sample_period_s)
        b = b * numerator[0] / denominator[-1]
    else:
        b, a, _ = cont2discrete((numerator, denominator), sample_period_s, method="foh")
        b = np.ravel(b)
    return b, a, lfilter_zi(b, a)


def _lags(numerator: tuple[float, ...],
          denominator: tuple[float, ...]) -> tuple[float, float] | None:
    """Return the time constants of two lags in series that are far apart, else None.

    The faster one may be zero.
    """
    if (len(numerator), len(denominator)) != (1, 3) or denominator[2] == 0.0:
        return None
    product, total, _ = np.array(denominator) / denominator[2]
    if total <= 0.0 or product < 0.0 or product > FAR_APART * total**2:
        return None
    slow_s = 0.5 * (total + np.sqrt(total**2 - 4.0 * product))
    return slow_s, product / slow_s


def _two_lags(slow_s: float, fast_s: float,
              sample_period_s: float) -> tuple[FloatArray, FloatArray]:
    """Return the discrete coefficients of two lags in series, by partial fractions.

    The usual matrix exponential loses all digits if one lag is very short.
    """
    (slow_b, slow_a), (fast_b, fast_a) = (
        _first_order_lag(time_s, sample_period_s) for time_s in (slow_s, fast_s))
    b = slow_s * np.convolve(slow_b, fast_a) - fast_s * np.convolve(fast_b, slow_a)
    return b / (slow_s - fast_s), np.convolve(slow_a, fast_a)


def _first_order_lag(time_constant_s: float,
                     sample_period_s: float) -> tuple[FloatArray, FloatArray]:
    """Return the coefficients of 1 / (1 + T s), T >= 0, for a signal straight between samples."""
    if time_constant_s == 0.0:
        return np.array([1.0, 0.0]), np.array([1.0, 0.0])
    periods = sample_period_s / time_constant_s
    decay, mean = np.exp(-periods), -np.expm1(-periods) / periods
    return np.array([1.0 - mean, mean - decay]), np.array([1.0, -decay])


def unfiltered_period(numerator: Sequence[float], denominator: Sequence[float],
                      period: FloatArray, sample_period_s: float) -> FloatArray:
    """Return the period, (N,), in front of a transfer function that gives a period behind it.

    The transfer function is given as in `filtered`.
    """
    b, a, _ = _discrete(tuple(numerator), tuple(denominator), sample_period_s)
    turns = np.exp(-2j * np.pi * np.fft.rfftfreq(period.size))
    response = np.polyval(b[::-1], turns) / np.polyval(a[::-1], turns)
    return np.fft.irfft(np.fft.rfft(period) / response, period.size)


def slowed(numerator: Sequence[float], denominator: Sequence[float],
           factor: float) -> control.StateSpace:
    """Return a continuous transfer function of s with its time scaled by a factor.

    It is given as in `filtered`. The scaling keeps its numbers well conditioned for any time.
    """
    # That of python-control takes ten times as long, as it looks for a minimal realisation.
    a, b, c, d = tf2ss(numerator, denominator)
    return control.ss(a / factor, b / factor, c, d)
