# SPDX-License-Identifier: BSD-3-Clause
"""Linear filters on sampled displacements, which are straight between samples, not held."""

from functools import lru_cache

import control
import numpy as np
from scipy.signal import cont2discrete, lfilter, lfilter_zi


def filtered(numerator, denominator, signal, sample_period_s, rest=None):
    """Signal behind a continuous transfer function, from rest.

    Parameters
    ----------
    numerator, denominator : sequence of float
        Of the powers of s, the highest first.
    signal : (N,) array
        Taken as straight between samples.
    sample_period_s : float
    rest : float, optional
        Level at which the signal has rested before; its first value by default.

    Returns
    -------
    (N,) array
    """
    b, a, settled = _discrete(tuple(numerator), tuple(denominator), sample_period_s)
    rest = float(signal[0]) if rest is None else rest
    return lfilter(b, a, signal, zi=settled * rest)[0]


@lru_cache(maxsize=2048)
def _discrete(numerator, denominator, sample_period_s):
    """Coefficients, and the state in which a level of 1 has settled; a scan asks again."""
    b, a, _ = cont2discrete((numerator, denominator), sample_period_s, method="foh")
    b = np.ravel(b)
    return b, a, lfilter_zi(b, a)


def unfiltered_period(numerator, denominator, period, sample_period_s):
    """One period in front of a continuous transfer function of a periodic signal behind it.

    Parameters
    ----------
    numerator, denominator : sequence of float
        As in `filtered`.
    period : (N,) array
    sample_period_s : float

    Returns
    -------
    (N,) array
    """
    b, a, _ = _discrete(tuple(numerator), tuple(denominator), sample_period_s)
    turns = np.exp(-2j * np.pi * np.fft.rfftfreq(period.size))
    response = np.polyval(b[::-1], turns) / np.polyval(a[::-1], turns)
    return np.fft.irfft(np.fft.rfft(period) / response, period.size)


def slowed(numerator, denominator, factor):
    """A transfer function of s, in time that runs slower by a factor.

    Its numbers stay well scaled however short the time.

    Parameters
    ----------
    numerator, denominator : sequence of float
        As in `filtered`.
    factor : float

    Returns
    -------
    control.StateSpace
        Continuous.
    """
    system = control.tf2ss(numerator, denominator)
    return control.ss(system.A / factor, system.B / factor, system.C, system.D)
