# SPDX-License-Identifier: BSD-3-Clause
"""The voltage of a recording between its rows."""

from collections.abc import Collection

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_models.effects import Effect
from piezo_models.effects.amplifier_lag import PARTS_OF_LONG, parts_of_rows
from piezo_models.effects.band_limited_voltage import BandLimitedVoltage, means_of_parts


def in_parts(voltage_v: FloatArray, effects: Collection[Effect], sample_period_s: float,
             samples_per_mean: int) -> tuple[FloatArray, int]:
    """Return a recorded voltage in the parts in which its rows are simulated, and their number.

    Parameters
    ----------
    voltage_v : (N,) array
        Of the rows.
    effects : collection of Effect
        On the voltage; those that act within a row ask for parts.
    samples_per_mean : int
        Rows that are means of several samples stay whole.

    Returns
    -------
    voltage_v : (N parts,) array
        In front of the effects: held, or with a `BandLimitedVoltage` its mean over each part.
    parts : int
        Of a row.
    """
    is_smooth = any(isinstance(effect, BandLimitedVoltage) for effect in effects)
    if is_smooth and samples_per_mean == 1:
        return means_of_parts(voltage_v, PARTS_OF_LONG), PARTS_OF_LONG
    parts = parts_of_rows(effects, sample_period_s, samples_per_mean)
    return np.repeat(voltage_v, parts), parts
