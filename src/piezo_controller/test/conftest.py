# SPDX-License-Identifier: BSD-3-Clause
import sys
from functools import partialmethod
from pathlib import Path

import numpy as np
import pytest
from replaced import replaced
from short_design import FEW_SCALINGS

from piezo_controller.feedback.feedback_design import design_feedback
from piezo_controller.feedback.robustness import PlantErrors
from piezo_controller.feedback.synthesis.weights import load_weights
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

sys.path.insert(0, str(Path(__file__).parent / "axes"))  # the stand-in of a stage of two axes


@pytest.fixture(scope="session")
def model_path(stage_model, tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "model.json"
    save_model(path, IdentifiedModel(stage_model, (-20.0, 120.0)))
    return path


@pytest.fixture(scope="session")
def stage_model():
    """Return the stage of thesis chapter 4 with a density that is no sum f(alpha) + g(beta)."""
    cells = 35
    width_v = 140 / cells
    alpha, beta = np.indices((cells, cells)) * width_v - 20 + width_v / 2
    density = np.tril(6e-4 + 0.07 * np.exp(-(alpha - beta) / 12)
                      * (1 + 0.1 * np.cos((alpha + beta) / 90)))
    return StageModel(
        PreisachModel(-20.0, 120.0, density, -9.0),
        CreepDynamics((0.01419, 0.1684, 0.2402, 1.053, 17.57),
                      (0.01458, 0.1716, 0.241, 1.07, 18.29)),
        ElectricVibrationDynamics(0.00049, (2846.0, 4909.0), (0.68535, 0.081992)))


@pytest.fixture(scope="session")
def controller(stage_model):
    """Return the default design for the stage, of few scalings: for tests that take it as given."""
    with replaced(*FEW_SCALINGS):
        return design_feedback(stage_model, load_weights(), model_sha256="0" * 64)


@pytest.fixture(scope="module")
def short_search():
    """Search few scalings: for tests that take a design as given, not for those of its quality.

    The structured singular value is computed at a third of the frequencies meanwhile, and the
    loop is measured at an eighth of them.
    """
    with replaced(*FEW_SCALINGS):
        yield


@pytest.fixture
def few_draws(monkeypatch):
    """Close the loop with 20 drawn plants instead of 200."""
    monkeypatch.setattr(PlantErrors, "robustness", partialmethod(
        PlantErrors.robustness, samples=20))


CLOCK_PERIOD_S = 25e-6
NOISE_UM = 0.009


@pytest.fixture(scope="session")
def exchange_with():
    """Make the `exchange` of a stage that is another model, with noise and an offset."""
    def make(model, offset_um=0.0):
        memory, system = model.memory(), zoh(model.linear(), CLOCK_PERIOD_S)
        hysteresis, states = memory.hysteresis, [memory.linear_state]
        draws = np.random.default_rng(5)

        def exchange(voltage_v):
            output_um = model.hysteresis.simulate(voltage_v, hysteresis)
            displacement_um, states[0] = continue_linear(system, output_um, states[0])
            return displacement_um + offset_um + draws.normal(scale=NOISE_UM, size=len(voltage_v))

        return exchange

    return make
