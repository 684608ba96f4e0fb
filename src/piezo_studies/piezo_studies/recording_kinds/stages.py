# SPDX-License-Identifier: BSD-3-Clause
"""Two stages of other mathematical forms than the model: generalised plays, and a Duhem equation.

Both creep by the logarithm of time, through many poles that no fit knows. An amplifier's lag and
modes side by side follow. Rows are read at the instant at which their voltage changes.
"""

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_studies.other_makes.hystereses import Duhem, Plays
from piezo_studies.other_makes.linear_system import lag, logarithmic_creep, mode
from piezo_studies.other_makes.stage import HeldVoltage, Stage

REST_S = 20.0
"""For how long a stage rests under the first voltage of a recording, after a rise from 0 V."""

RISE_ROWS = 400
"""Rows of that rise."""


def play_stage() -> Stage:
    """Return plays between two curves of the voltage, over 100 V and some 13 um."""
    widths_v = np.linspace(0.0, 25.0, 12)
    weights = 0.12 * np.append(0.8, 0.04 * np.exp(-widths_v[1:] / 15.0))
    modes = mode(620.0, 0.02, 0.92).beside(mode(1450.0, 0.015, 0.08))
    return Stage(Plays(widths_v, weights, (1.0, 1.5e-3), (1.002, 1.0e-3)),
                 logarithmic_creep(0.012, 1e-3, 1e4).then(modes).then(lag(4e-4)))


def duhem_stage() -> Stage:
    """Return the Duhem equation, over 100 V and some 30 um, with slower modes."""
    modes = mode(210.0, 0.03, 0.9).beside(mode(760.0, 0.02, 0.1))
    return Stage(Duhem(0.2, 0.2, 0.4, 0.03, 0.5),
                 logarithmic_creep(0.008, 1e-3, 1e4).then(modes).then(lag(8e-4)))


def displacement_um(stage: Stage, voltage_v: FloatArray, period_s: float) -> FloatArray:
    """Return where a rested stage is while a voltage plays.

    Parameters
    ----------
    voltage_v : ndarray, shape (N,)
    period_s : float
        Of the rows.

    Returns
    -------
    ndarray, shape (N,)
    """
    past_v = np.append(np.linspace(0.0, voltage_v[0], RISE_ROWS),
                       np.full(RISE_ROWS, voltage_v[0]))
    return stage.displacement_um([HeldVoltage(past_v, REST_S / RISE_ROWS)],
                                 HeldVoltage(voltage_v, period_s))
