# SPDX-License-Identifier: BSD-3-Clause
"""Models of the simulated stage whose parameters all have the same relative error."""

from typing import Any

import numpy as np

from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_sim.plant.plant_file import read_plant

CELLS = 50


def wrong_model(part, seed):
    """Return the model of the default plant with an error of random sign in every parameter.

    Parameters
    ----------
    part : float
        Relative error of each parameter except the voltage limits.
    """
    generator = np.random.default_rng(seed)

    def wrong(values):
        values = np.asarray(values, dtype=float)
        return values * (1.0 + part * generator.choice([-1.0, 1.0], values.shape))

    plant = read_plant(None)
    stage: tuple[Any, ...] = plant.stage
    hysteresis, creep, lag, *modes = stage
    amplifier: Any = plant.amplifier[0]
    return StageModel(
        _hysteresis(hysteresis, amplifier.voltage_min_v, amplifier.voltage_max_v, wrong),
        CreepDynamics(tuple(wrong(creep.poles_rad_per_s)), tuple(wrong(creep.zeros_rad_per_s))),
        ElectricVibrationDynamics(
            float(wrong(lag.time_constant_s)),
            tuple(wrong([mode.frequency_rad_per_s for mode in modes])),
            tuple(wrong([mode.damping_ratio for mode in modes]))))


def _hysteresis(plant, lowest_v, highest_v, wrong):
    """Return the plant's density with wrong parameters, averaged over the cells of a grid."""
    broad, ridge, width_v, modulation, centre_v, period_v, offset_um = wrong([
        plant.broad_density_um_per_v2, plant.ridge_density_um_per_v2, plant.ridge_width_v,
        plant.position_modulation, plant.modulation_centre_v, plant.modulation_period_v,
        plant.offset_um])
    cell_v = (highest_v - lowest_v) / CELLS
    alpha_v, beta_v = lowest_v + (np.indices((CELLS, CELLS)) + 0.5) * cell_v
    span_v, middle_v = alpha_v - beta_v, (alpha_v + beta_v) / 2
    ratio = cell_v / width_v
    inside = 2 * (ratio - 1 + np.exp(-ratio)) / ratio**2  # for the triangles on the diagonal
    profile = np.where(span_v > cell_v / 2, np.exp(-span_v / width_v)
                       * (2 * np.sinh(ratio / 2) / ratio) ** 2, inside)
    crest = 1.0 + modulation * np.cos(2 * np.pi * (middle_v - centre_v) / period_v)
    return PreisachModel(lowest_v, highest_v, np.tril((broad + ridge * profile) * crest), offset_um)
