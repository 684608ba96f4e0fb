# SPDX-License-Identifier: BSD-3-Clause
"""Voltages that are repeated after a gentle beginning, and what a model does then."""

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_controller.feedforward.approach import FADE_S
from piezo_controller.references.smooth_rise import minimum_jerk
from piezo_models.axes.coupled import CoupledModel

SETTLED = 1e-6
"""Part of a mode's beginning that may be left when the errors are measured: 0.0001 %."""

LONGEST_SETTLE_S = 2.0
"""Creep that is not over then is part of the error, as on a stage."""


def faded_in(voltage_v: FloatArray, model: CoupledModel, before: int = 0) -> FloatArray:
    """Return voltages (B, n) over `FADE_S` that lead from the operating point into a period (N, n).

    They end some samples before its beginning.
    """
    samples = round(FADE_S / model.sample_period_s)
    at = np.arange(-samples - before, -before) % len(voltage_v)
    rest_v = model.operating_voltage_v
    faded: FloatArray = rest_v + minimum_jerk(samples)[:, None] * (voltage_v[at] - rest_v)
    return faded


def repeated(voltage_v: FloatArray, model: CoupledModel) -> FloatArray:
    """Return the displacement (um) in one period of voltages, (N, n), after they were faded in.

    Modes and hysteresis have settled then.
    """
    period_s, samples = model.sample_period_s, len(voltage_v)
    slowest = -np.max(model.poles_rad_per_s.real, initial=-1.0 / period_s)
    settle_s = -np.log(SETTLED) / slowest
    if model.softening is not None:
        settle_s = max(settle_s, -np.log(SETTLED) * model.softening.memory_s)
    settle = round(min(settle_s, LONGEST_SETTLE_S) / period_s)
    if any(each.hysteresis for each in model.actuators):
        settle = max(settle, samples)  # a period wipes out what came before
    played_v = np.concatenate([faded_in(voltage_v, model, settle),
                               voltage_v[np.arange(-settle, samples) % samples]])
    return model.simulate(played_v)[-samples:]
