# SPDX-License-Identifier: BSD-3-Clause
"""Make a stage model without identification, and a backend that plays it."""

import numpy as np

from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.linear.dynamics import (
    CreepDynamics,
    ElectricVibrationDynamics,
    continue_linear,
    zoh,
)
from piezo_models.model_file import save_model

VOLTAGE_RANGE_V = (-20.0, 120.0)
SAMPLE_RATE_HZ = 40000.0

CREEP = CreepDynamics(
    (0.01419, 0.1684, 0.2402, 1.053, 17.57), (0.01458, 0.1716, 0.241, 1.07, 18.29))
DYNAMICS = ElectricVibrationDynamics(0.00049, (2846.0, 4909.0), (0.68535, 0.081992))


def preisach_model(levels):
    """Hysteresis with a density that falls off beside the line alpha = beta (um/V^2)."""
    lowest_v, highest_v = VOLTAGE_RANGE_V
    centres_v = lowest_v + (np.arange(levels) + 0.5) * (highest_v - lowest_v) / levels
    width_v = centres_v[:, None] - centres_v[None, :]
    density = np.tril(6e-4 + 0.078 * np.exp(-((width_v / 12.0) ** 2)))
    return PreisachModel(lowest_v, highest_v, density, -9.7)


def stage_model():
    """Return the dynamics of thesis 4.7.1 behind a hysteresis of the same size as the thesis'."""
    return StageModel(preisach_model(50), CREEP, DYNAMICS)


def write_model(path):
    """Write the model as a model file."""
    save_model(path, IdentifiedModel(stage_model(), VOLTAGE_RANGE_V))


class ModelStage:
    """The model as a backend of the stage node, without noise."""

    sample_rate_hz = SAMPLE_RATE_HZ

    def __init__(self):
        self._model = stage_model()
        self._discrete = zoh(self._model.linear(), 1.0 / self.sample_rate_hz)

    def open(self):
        """Put the stage to rest."""
        self._memory = self._model.memory()

    def exchange(self, voltage_v):
        """Play voltages; see ``piezo_stage_driver.backends.backend.StageBackend``."""
        hysteresis_um = self._model.hysteresis.simulate(voltage_v, self._memory.hysteresis)
        displacement_um, self._memory.linear_state = continue_linear(
            self._discrete, hysteresis_um, self._memory.linear_state)
        return displacement_um

    def close(self):
        """Nothing to let go."""
