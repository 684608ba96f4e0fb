# SPDX-License-Identifier: BSD-3-Clause
"""What a hysteresis that is not quite right leaves in a fast record: slow, large, and no vibration.

A fit of lag and modes would bend until it explains that too, with modes that no structure has.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_identification.estimators.dynamics.fast_creep import best_free_fit
from piezo_identification.estimators.dynamics.fast_record import FastRecord, independent
from piezo_identification.estimators.dynamics.output_error import ROWS_OF_SEARCH
from piezo_identification.estimators.dynamics.physical_standing import (
    FAR_BELOW,
    HEAVY_DAMPING,
    LEAST_DAMPING,
)

MOST_WAVES = 300
"""Half periods of the fastest wave: a longer record tells slow motions from vibrations itself."""

MOST_OF_IT = 0.5
"""Part of the power of what free poles leave from which it is called slow."""


def beside_slow_misfit(record: FastRecord) -> FastRecord:
    """Let a record hold any slow motion beside the response, where it needs to.

    It needs to where free poles, as pairs, which neither a lag nor creep has, lie far below those
    that ring, and are no vibration by their damping, or where most of what they leave is as slow.
    Cosines up to there then take what is slow.

    Parameters
    ----------
    record : FastRecord

    Returns
    -------
    FastRecord
        The same one where there is no need.
    """
    coarse = record.thinned(ROWS_OF_SEARCH)
    best = best_free_fit(coarse)
    frequencies, dampings = np.abs(best.poles), -best.poles.real / np.abs(best.poles)
    rings = (dampings >= LEAST_DAMPING) & (dampings < HEAVY_DAMPING)
    if not rings.any():
        return record
    fastest = FAR_BELOW * frequencies[rings].min()
    period_s = record.input.sample_period_s
    waves = min(int(fastest * np.ptp(record.kept) * period_s / np.pi), MOST_WAVES)
    is_slow_pair = (best.poles.imag != 0.0) & ~rings & (frequencies < fastest)
    if not waves or not is_slow_pair.any() and _share(
            best.residual, slow_waves(coarse.kept, waves)) < MOST_OF_IT:
        return record
    return replace(record, fixed=np.column_stack([record.fixed, slow_waves(record.kept, waves)]))


def _share(signal: FloatArray, columns: FloatArray) -> float:
    """Part of a signal's power that columns can make up for."""
    span = independent(columns)
    return float(np.sum((span.T @ signal) ** 2) / np.sum(signal**2))


def slow_waves(rows: NDArray[np.intp], count: int) -> FloatArray:
    """Return cosines of one, two and more half periods over rows of a record, shape (N, count)."""
    phase = np.pi * (rows - rows[0]) / np.ptp(rows)
    return np.cos(np.outer(phase, np.arange(1, count + 1)))
