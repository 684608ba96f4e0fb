# SPDX-License-Identifier: BSD-3-Clause
"""The plant simulated in section 4.6; its creep gain of 2 is included in the hysteresis."""

import numpy as np

from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics

HIGHEST_V = 5.0
NOISE_UM = 0.07
FINE_CELLS = 200
CREEP_GAIN = 2.0


def density_um_per_v2(levels_v):
    """Return the density 2 (0.1 + 0.05 (alpha + beta)) at the cell centres, shape (L, L)."""
    middles_v = 0.5 * (levels_v[:-1] + levels_v[1:])
    return np.tril(CREEP_GAIN * (0.1 + 0.05 * (middles_v[:, None] + middles_v)))


def known_plant():
    """Return the plant as a `StageModel`."""
    levels_v = np.linspace(0.0, HIGHEST_V, FINE_CELLS + 1)
    return StageModel(
        PreisachModel(0.0, HIGHEST_V, density_um_per_v2(levels_v)),
        CreepDynamics((0.02, 10.0), (0.12, 15.0)),
        ElectricVibrationDynamics(0.001, (3000.0,), (0.1,)),
    )
