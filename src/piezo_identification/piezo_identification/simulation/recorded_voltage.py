# SPDX-License-Identifier: BSD-3-Clause
"""The voltage of a recording between its rows."""

from collections.abc import Collection

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_models.effects import Effect
from piezo_models.effects.amplifier_lag import PARTS, parts_of_rows
from piezo_models.effects.band_limited_voltage import BandLimitedVoltage, means_of_parts


def in_parts(voltage_v: FloatArray, effects: Collection[Effect], sample_period_s: float,
             samples_per_mean: int) -> tuple[FloatArray, int]:
    """Return a recorded voltage divided into the parts in which its rows are simulated.

    Parameters
    ----------
    voltage_v : (N,) array
        Voltage of the rows.
    effects : collection of Effect
        Effects on the voltage; those that act within a row require several parts.
    samples_per_mean : int
        Samples averaged in a row; averaged rows are not divided.

    Returns
    -------
    voltage_v : (N parts,) array
        Voltage before the effects: held, or its mean over each part for a `BandLimitedVoltage`.
    parts : int
        Number of parts of a row.
    """
    is_smooth = any(isinstance(effect, BandLimitedVoltage) for effect in effects)
    if is_smooth and samples_per_mean == 1:
        return means_of_parts(voltage_v, PARTS), PARTS
    parts = parts_of_rows(effects, sample_period_s, samples_per_mean)
    return np.repeat(voltage_v, parts), parts
