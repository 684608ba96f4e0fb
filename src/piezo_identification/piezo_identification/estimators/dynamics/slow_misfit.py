# SPDX-License-Identifier: BSD-3-Clause
"""What a hysteresis that is not quite right leaves in a fast record: slow, large, and no vibration.

A fit of lag and modes would bend until it explains that too, with modes that no structure has.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_identification.estimators.dynamics.fast_creep import best_free_fit
from piezo_identification.estimators.dynamics.fast_record import FastRecord

LEAST_DAMPING = 5e-4
"""Damping ratio below which no mode of a structure lies that is glued or screwed together."""

HEAVY_DAMPING, FAR_BELOW = 0.15, 0.05
"""Damping ratio, and frequency over that of the lowest mode which rings, of what creeps: structures
have no such modes, and what a hysteresis that is not quite right leaves looks like one."""

MOST_WAVES = 300
"""Half periods of the fastest wave: a longer record parts slow motions from vibrations itself."""

MOST_OF_THE_MOTION = 0.95
"""Part of the input's power that counts in how fast its loops are."""


def beside_slow_misfit(record: FastRecord) -> FastRecord:
    """Let a record hold any slow motion beside the response, where it needs to.

    It needs to where its loops are far slower than what rings, and free poles take pairs, which
    neither a lag nor creep has, to follow them. Cosines up to there then take what is slow.

    Returns
    -------
    FastRecord
        The same one where there is no need.
    """
    poles = best_free_fit(record).poles
    frequencies, dampings = np.abs(poles), -poles.real / np.abs(poles)
    period_s = record.input.sample_period_s
    far_above = loop_rad_per_s(record.input.samples, period_s) / FAR_BELOW
    rings = (dampings >= LEAST_DAMPING) & (dampings < HEAVY_DAMPING) & (frequencies > far_above)
    if not rings.any():
        return record
    fastest = FAR_BELOW * frequencies[rings].min()
    waves = min(int(fastest * np.ptp(record.kept) * period_s / np.pi), MOST_WAVES)
    if not waves or not np.any((poles.imag != 0.0) & (frequencies < fastest)):
        return record
    return replace(record, fixed=np.column_stack([record.fixed, slow_waves(record.kept, waves)]))


def loop_rad_per_s(input_um: FloatArray, sample_period_s: float) -> float:
    """Return the frequency up to which nearly all power of an input lies, shape (N,)."""
    power = np.abs(np.fft.rfft((input_um - input_um.mean()) * np.hanning(input_um.size))) ** 2
    line = int(np.searchsorted(np.cumsum(power), MOST_OF_THE_MOTION * power.sum()))
    return 2.0 * np.pi * line / (input_um.size * sample_period_s)


def slow_waves(rows: NDArray[np.intp], count: int) -> FloatArray:
    """Return cosines of one, two and more half periods over rows of a record, shape (N, count)."""
    phase = np.pi * (rows - rows[0]) / np.ptp(rows)
    return np.cos(np.outer(phase, np.arange(1, count + 1)))
