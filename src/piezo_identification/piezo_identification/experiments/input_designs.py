# SPDX-License-Identifier: BSD-3-Clause
"""Smooth arcs between voltages, and harmonics whose amplitude rises in steps."""

import numpy as np

from piezo_common.arrays import FloatArray


def arc(start: float, end: float, samples: int) -> FloatArray:
    """Return half a cosine (samples,) from start to end, reached one sample after the last."""
    return start + 0.5 * (end - start) * (1.0 - np.cos(np.pi * np.arange(samples) / samples))


def stair_amplitudes(level_count: int, highest_v: float, below_the_top: float = 0.0) -> FloatArray:
    """Return L equally spaced amplitudes up to the highest voltage, (3.7), (4.7), (4.8).

    Parameters
    ----------
    below_the_top : float
        Fraction of a step by which each amplitude is lowered; 0.5 for (3.6).
    """
    return (np.arange(1, level_count + 1) - below_the_top) * highest_v / level_count


def stair_harmonics(
    time_s: FloatArray, amplitudes_v: FloatArray, harmonic_period_s: float,
) -> FloatArray:
    """Return harmonics from zero to each of the amplitudes in turn and back, (2.29), (3.6), (4.6).

    Parameters
    ----------
    time_s : ndarray, shape (N,)
    amplitudes_v : ndarray, shape (L,)
        Repeated after L periods.

    Returns
    -------
    ndarray, shape (N,)
    """
    # Rounding must not put a whole number of periods into the period before.
    periods = np.asarray(time_s) / harmonic_period_s
    harmonic = np.floor(periods + 1e-9).astype(int) % len(amplitudes_v)
    return 0.5 * np.asarray(amplitudes_v)[harmonic] * (1.0 - np.cos(2.0 * np.pi * periods))
