# SPDX-License-Identifier: BSD-3-Clause
import json
from dataclasses import replace

import numpy as np
import pytest

from piezo_models.cascade import StageModel
from piezo_models.hysteresis.hysteretic_creep import HystereticCreep
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_models.model_document import ModelFileError
from piezo_models.model_file import load_model, save_model

CREEP = HystereticCreep((0.0, 15.0, 40.0), (0.5, 2.0, 2.0), (0.01, 0.02, -0.005))


@pytest.fixture(scope="module")
def stage():
    hysteresis = PreisachModel(-20.0, 120.0, np.tril(np.full((20, 20), 0.01)), -9.0)
    dynamics = ElectricVibrationDynamics(5e-4, (2846.0,), (0.3,))
    return StageModel(hysteresis, CreepDynamics((0.2,), (0.21,)), dynamics, CREEP)


def random_walk(seed, count=400):
    walk = np.cumsum(np.random.default_rng(seed).normal(scale=12.0, size=count))
    return -20.0 + np.abs((walk + 140.0) % 280.0 - 140.0)


def test_after_a_step_the_output_relaxes_to_the_play_of_the_voltage():
    memory = CREEP.memory([-20.0])
    time_s = np.arange(2000) * 1e-2
    output_um = CREEP.simulate(np.full(time_s.size, 100.0), 1e-2, memory)
    expected_um = sum(
        weight * (100.0 - width - (120.0 - 2.0 * width) * np.exp(-time_s / tau))
        for width, tau, weight in zip(
            CREEP.half_widths_v, CREEP.time_constants_s, CREEP.weights_um_per_v, strict=True
        )
    )
    np.testing.assert_allclose(output_um, expected_um, atol=1e-12)


def test_the_settled_output_depends_on_the_branch():
    rising, falling = (CREEP.held_um(CREEP.memory(path)) for path in ([-20, 50], [-20, 120, 50]))
    np.testing.assert_allclose(falling - rising, 0.02 * 30.0 - 0.005 * 60.0)


@pytest.mark.parametrize("seed", range(5))
def test_the_extremes_that_are_not_wiped_out_are_enough(stage, seed):
    voltage_v = random_walk(seed)
    past = stage.hysteresis.memory()
    stage.hysteresis.simulate(voltage_v, past)
    whole = CREEP.memory(np.append(-20.0, voltage_v))
    remembered = stage.memory(hysteresis=past).hysteretic_creep
    np.testing.assert_allclose(remembered.positions_v, whole.positions_v, atol=1e-12)


def test_the_stage_adds_it_to_the_hysteresis_however_the_input_is_divided(stage):
    voltage_v = random_walk(7)
    memory = stage.memory()
    kept = memory.copy()
    parts_um = [stage.simulate(part, 1e-3, memory) for part in np.split(voltage_v, [100, 101])]
    whole_um = stage.simulate(voltage_v, 1e-3, kept)
    np.testing.assert_allclose(np.concatenate(parts_um), whole_um, atol=1e-9)
    without_um = replace(stage, hysteretic_creep=None).simulate(voltage_v, 1e-3)
    assert np.ptp(whole_um - without_um) > 0.1


def test_a_stage_that_has_rested_stays_at_rest(stage):
    displacement_um = stage.simulate(np.full(1000, 60.0), 1e-2, stage.memory(60.0))
    np.testing.assert_allclose(displacement_um, displacement_um[0], atol=1e-9)


def test_the_model_file_keeps_it_and_names_what_is_wrong_with_it(stage, tmp_path):
    path = tmp_path / "model.json"
    save_model(path, IdentifiedModel(stage, (-20.0, 120.0)))
    assert load_model(path).model.hysteretic_creep == CREEP
    document = json.loads(path.read_text())
    document["hysteretic_creep"]["time_constants_s"][0] = -1.0
    path.write_text(json.dumps(document))
    with pytest.raises(ModelFileError, match=r"hysteretic_creep.time_constants_s\[0\] is out"):
        load_model(path)


def test_a_model_without_it_is_saved_without_the_field(stage, tmp_path):
    path = tmp_path / "model.json"
    save_model(path, IdentifiedModel(replace(stage, hysteretic_creep=None), (-20.0, 120.0)))
    assert "hysteretic_creep" not in json.loads(path.read_text())
    assert load_model(path).model.hysteretic_creep is None


@pytest.mark.parametrize("arguments, named", [
    (((-1.0,), (1.0,), (0.1,)), "half_widths_v"),
    (((1.0,), (0.0,), (0.1,)), "time_constants_s"),
    (((1.0,), (1.0,), (np.nan,)), "weights_um_per_v"),
    (((1.0, 2.0), (1.0,), (0.1,)), "2 half widths"),
])
def test_parameters_that_cannot_be_are_refused(arguments, named):
    with pytest.raises(ValueError, match=named):
        HystereticCreep(*arguments)


def test_memory_of_a_model_without_it_is_refused(stage):
    plain = replace(stage, hysteretic_creep=None)
    with pytest.raises(ValueError, match="no part for the hysteretic creep; take one from this"):
        stage.simulate([0.0, 1.0], 1e-3, plain.memory())
