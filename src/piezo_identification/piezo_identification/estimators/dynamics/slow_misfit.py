# SPDX-License-Identifier: BSD-3-Clause
"""Slow errors that an inexact hysteresis leaves in a fast record: large, but no vibration.

A fit of lag and modes would describe them by modes that no structure has.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_identification.estimators.dynamics.fast_creep import best_free_fit
from piezo_identification.estimators.dynamics.fast_record import FastRecord

LEAST_DAMPING = 5e-4
"""Damping ratio below which no glued or screwed structure has modes."""

HEAVY_DAMPING, FAR_BELOW = 0.15, 0.05
"""Damping ratio, and frequency relative to the lowest ringing mode, of slow errors. Structures have
no such modes, but errors of the hysteresis look like them."""

MOST_WAVES = 300
"""Largest number of half periods of the fastest cosine: a longer record separates slow motion from
vibration without them."""

MOST_OF_THE_MOTION = 0.95
"""Part of the input power that defines the frequency of its loops."""


def project_out_slow_error(record: FastRecord) -> FastRecord:
    """Remove slow errors from a record if it has them.

    It does if its loops are far slower than the ringing modes, and free poles form slow oscillating
    pairs, which neither a lag nor creep has. Slow cosines among the further signals then describe
    the errors; of a long record, slow lines are left out.

    Returns
    -------
    FastRecord
        The same record if it has none.
    """
    poles = best_free_fit(record).poles
    frequencies, dampings = np.abs(poles), -poles.real / np.abs(poles)
    period_s = record.input.sample_period_s
    far_above = loop_rad_per_s(record.input.samples, period_s) / FAR_BELOW
    # Superfluous poles may be faster than half the sample rate, which no row shows.
    rings = ((dampings >= LEAST_DAMPING) & (dampings < HEAVY_DAMPING)
             & (frequencies > far_above) & (frequencies < np.pi / period_s))
    if not rings.any():
        return record
    fastest = FAR_BELOW * frequencies[rings].min()
    waves = min(int(fastest * np.ptp(record.kept) * period_s / np.pi), MOST_WAVES)
    if not waves or not np.any((poles.imag != 0.0) & (frequencies < fastest)):
        return record
    if record.is_long:
        return replace(record, slowest_rad_per_s=fastest)
    return replace(record, fixed=np.column_stack([record.fixed, slow_waves(record.kept, waves)]))


def loop_rad_per_s(input_um: FloatArray, sample_period_s: float) -> float:
    """Return the frequency up to which nearly all power of an input lies, shape (N,)."""
    power = np.abs(np.fft.rfft((input_um - input_um.mean()) * np.hanning(input_um.size))) ** 2
    line = int(np.searchsorted(np.cumsum(power), MOST_OF_THE_MOTION * power.sum()))
    return 2.0 * np.pi * line / (input_um.size * sample_period_s)


def slow_waves(rows: NDArray[np.intp], count: int) -> FloatArray:
    """Return cosines of 1, 2, 3, ... half periods over rows of a record, shape (N, count)."""
    phase = np.pi * (rows - rows[0]) / np.ptp(rows)
    return np.cos(np.outer(phase, np.arange(1, count + 1)))
