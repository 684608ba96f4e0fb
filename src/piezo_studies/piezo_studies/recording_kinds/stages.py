# SPDX-License-Identifier: BSD-3-Clause
"""Two stages that differ in form from the model: generalised plays, and a Duhem equation.

Both have logarithmic creep with more poles than any fit, followed by parallel modes and a lag. Rows
are read at the time at which their voltage changes.
"""

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_studies.other_makes.hystereses import Duhem, Plays
from piezo_studies.other_makes.linear_system import lag, logarithmic_creep, mode
from piezo_studies.other_makes.stage_by_rows import HeldVoltage, Stage

REST_S = 20.0
"""Duration (s) of the rise from 0 V to the first voltage of a recording, and of the rest there."""

RISE_ROWS = 400
"""Number of rows of that rise, and of that rest."""


def play_stage() -> Stage:
    """Return a stage with plays between two curves, for 100 V and about 13 um."""
    widths_v = np.linspace(0.0, 25.0, 12)
    weights = 0.12 * np.append(0.8, 0.04 * np.exp(-widths_v[1:] / 15.0))
    modes = mode(620.0, 0.02, 0.92).parallel_to(mode(1450.0, 0.015, 0.08))
    return Stage(Plays(widths_v, weights, (1.0, 1.5e-3), (1.002, 1.0e-3)),
                 logarithmic_creep(0.012, 1e-3, 1e4).then(modes).then(lag(4e-4)))


def duhem_stage() -> Stage:
    """Return a stage with the Duhem equation and slower modes, for 100 V and about 30 um."""
    modes = mode(210.0, 0.03, 0.9).parallel_to(mode(760.0, 0.02, 0.1))
    return Stage(Duhem(0.2, 0.2, 0.4, 0.03, 0.5),
                 logarithmic_creep(0.008, 1e-3, 1e4).then(modes).then(lag(8e-4)))


def displacement_um(stage: Stage, voltage_v: FloatArray, period_s: float) -> FloatArray:
    """Return the displacement of a rested stage while a voltage is played.

    Parameters
    ----------
    voltage_v : ndarray, shape (N,)

    Returns
    -------
    ndarray, shape (N,)
    """
    past_v = np.append(np.linspace(0.0, voltage_v[0], RISE_ROWS),
                       np.full(RISE_ROWS, voltage_v[0]))
    return stage.displacement_um([HeldVoltage(past_v, REST_S / RISE_ROWS)],
                                 HeldVoltage(voltage_v, period_s))
