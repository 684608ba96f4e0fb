# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics


@pytest.fixture
def uneven_model():
    """Return a density that is not additive in alpha and beta, with cells of no weight."""
    rng = np.random.default_rng(7)
    density = np.tril(rng.random((20, 20))) * 0.02
    density[rng.random((20, 20)) < 0.2] = 0.0
    return PreisachModel(-20.0, 120.0, density, offset_um=-3.0)


@pytest.fixture
def thesis_creep():
    """Return the creep of section 4.7.1."""
    return CreepDynamics(
        (0.01419, 0.1684, 0.2402, 1.053, 17.57), (0.01458, 0.1716, 0.241, 1.07, 18.29)
    )


@pytest.fixture
def thesis_dynamics():
    """Return the electric and vibration dynamics of section 4.7.1."""
    return ElectricVibrationDynamics(0.00049, (2846.0, 4909.0), (0.685, 0.082))


@pytest.fixture
def stage(uneven_model, thesis_creep, thesis_dynamics):
    return StageModel(uneven_model, thesis_creep, thesis_dynamics)
