# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import replace

import numpy as np
import pytest

from piezo_identification.commands.identify_command import main as identify_main
from piezo_identification.conditioning.waveforms import played
from piezo_identification.estimators.hysteresis.density_estimate import DensityEstimate
from piezo_identification.estimators.refinement.joint_fit import refine
from piezo_identification.estimators.refinement.joint_problem import HELD_OUT, STRETCHES
from piezo_identification.estimators.refinement.sensitivities import (
    factor_surfaces,
    hysteresis_parts,
    sensitivity_systems,
)
from piezo_identification.experiments import catalogue as experiments
from piezo_identification.identification import estimated_loops
from piezo_identification.prediction import predict, unseen_errors
from piezo_models.effects.delay import Delay
from piezo_models.effects.sensor_nonlinearity import SensorNonlinearity
from piezo_models.hysteresis.hysteretic_creep import HystereticCreep
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_models.model_file import load_model

pytestmark = pytest.mark.kernels


@pytest.fixture(scope="module")
def recordings(play):
    return {
        "creep": play(experiments.creep(period_s=60.0), 1, 100.0),
        "dynamics": play(experiments.dynamics(duration_s=0.2), 1),
        "hysteresis": play(experiments.hysteresis(level_count=8, harmonic_period_s=1.0), 1, 1000.0),
    }


@pytest.fixture(scope="module")
def unseen(play):
    return play(experiments.validation(arc_s=0.05, tones_s=0.2), 2)


@pytest.fixture(scope="module")
def wrong(plant):
    """The plant with errors in every component."""
    density = plant.hysteresis.density_um_per_v2
    tilt = 1.0 + np.linspace(-0.03, 0.03, len(density))[:, None]
    return replace(
        plant,
        hysteresis=replace(plant.hysteresis, density_um_per_v2=density * tilt),
        creep=CreepDynamics((0.0145, 0.165, 1.08, 17.0), (0.0149, 0.1685, 1.1, 17.8)),
        dynamics=ElectricVibrationDynamics(0.0005, (2800.0, 4930.0), (0.70, 0.085)),
    )


@pytest.fixture(scope="module")
def refined(wrong, recordings):
    return refine(wrong, recordings)


def test_sensitivities_are_derivatives_by_the_logarithms_of_the_parameters():
    creep = (np.array([0.1, 5.0]), np.array([0.11, 5.5]))
    dynamics = tuple(map(np.array, ([4e-4], [2000.0, 5000.0], [0.3, 0.1], [3000.0], [0.05])))
    frequency_hz = np.geomspace(1e-3, 3e3, 40)

    def systems(parts):
        return CreepDynamics(*parts[:2]), ElectricVibrationDynamics(float(parts[2][0]), *parts[3:])

    def logarithm(parts):
        return sum(np.log(system.response(frequency_hz)) for system in systems(parts))

    parts = [*creep, *dynamics]
    sensitivities = iter(sensitivity_systems(*systems(parts)))
    for index, part in enumerate(parts):
        for entry in range(part.size):
            up, down = ([value.copy() for value in parts] for _ in range(2))
            up[index][entry] *= np.exp(1e-5)
            down[index][entry] *= np.exp(-1e-5)
            slope = (logarithm(up) - logarithm(down)) / 2e-5
            response = next(sensitivities)(2j * np.pi * frequency_hz)
            np.testing.assert_allclose(response, slope, atol=1e-8)
    assert next(sensitivities, None) is None


def test_the_surfaces_of_the_density_sum_to_one():
    np.testing.assert_allclose(factor_surfaces(40).sum(axis=0), np.tril(np.ones((40, 40))))


def test_the_parts_of_a_hysteresis_sum_to_it(plant):
    reversible = np.linspace(0.1, 0.2, len(plant.hysteresis.density_um_per_v2))
    hysteresis = replace(plant.hysteresis, reversible_um_per_v=reversible)
    voltage_v = 50.0 + 60.0 * np.sin(np.linspace(0.0, 20.0, 300)) * np.linspace(1.0, 0.2, 300)
    total_um = sum(part.simulate(voltage_v) for part in hysteresis_parts(hysteresis))
    np.testing.assert_allclose(
        total_um + hysteresis.offset_um, hysteresis.simulate(voltage_v), atol=1e-9)


def test_refining_corrects_every_component(plant, refined):
    assert refined.improved
    assert refined.held_out_ratio < 1e-2
    frequency_hz = np.geomspace(0.05, 1000.0, 50)
    ratio = refined.model.response(frequency_hz) / plant.response(frequency_hz)
    assert np.abs(ratio - 1.0).max() < 2e-3
    np.testing.assert_allclose(
        refined.model.hysteresis.output_range_um[1], plant.hysteresis.output_range_um[1], rtol=2e-3
    )


def test_refining_is_as_good_on_another_input(wrong, refined, unseen):
    before, after = unseen_errors(wrong, unseen), unseen_errors(refined.model, unseen)
    assert all(after[name] < 0.3 * before[name] for name in before)


def test_the_standard_deviations_cover_the_errors_of_the_fast_dynamics(plant, refined):
    deviations = refined.standard_deviations["dynamics"]
    for name in ("mode_frequencies_rad_per_s", "damping_ratios"):
        error = np.subtract(getattr(refined.model.dynamics, name), getattr(plant.dynamics, name))
        assert (np.abs(error) < 5.0 * np.array(deviations[name])).all()


def test_what_does_not_help_on_stretches_held_out_is_not_kept(plant, recordings):
    part = played(recordings["hysteresis"])
    stretch = np.arange(part.voltage_v.size) * STRETCHES // part.voltage_v.size
    fitted = stretch % HELD_OUT != HELD_OUT // 2
    misleading = replace(part, displacement_um=part.displacement_um * (1.0 + 0.01 * fitted))
    result = refine(plant, {"hysteresis": misleading})
    assert result.held_out_ratio > 1.1
    assert not result.improved
    assert result.model is plant
    assert result.standard_deviations == {}


@pytest.fixture(scope="module")
def branchy(plant):
    """The plant with hysteretic creep, none of whose parameters is tried as it is."""
    return replace(plant, hysteretic_creep=HystereticCreep((10.0, 30.0), (3.0, 6.0), (0.01, 0.01)))


def test_hysteretic_creep_is_found_where_there_is_some(plant, branchy, play):
    # Steps to levels that are reached from both sides.
    levels_v = [-20.0, 50.0, 110.0, 50.0, 0.0, 80.0, 20.0, 120.0, 60.0, 30.0, 70.0, -20.0]
    steps = experiments.Experiment("steps", np.repeat(levels_v, 500), 0.01, 1, "steps")
    recordings = {"steps": play(steps, 1, 100.0, noise_um=0.001, stage=branchy)}
    result = refine(plant, recordings)
    assert result.model.hysteretic_creep is not None
    assert result.after_percent["steps"] < 0.2 * result.before_percent["steps"]
    other = experiments.Experiment("other", np.repeat(levels_v[::-1], 700), 0.01, 1, "other")
    unseen = play(other, 2, 100.0, noise_um=0.001, stage=branchy)
    before, after = unseen_errors(plant, unseen), unseen_errors(result.model, unseen)
    assert after["e_y_percent"] < 0.5 * before["e_y_percent"]


def test_effects_of_the_model_take_part_and_are_kept(plant, wrong, play):
    effects = (Delay(2e-4), SensorNonlinearity(0.0, 0.3, 0.0, 0.0, 50.0, 60.0))
    stage = replace(plant, effects=effects)
    recordings = {"dynamics": play(experiments.dynamics(duration_s=0.2), 1, stage=stage),
                  "hysteresis": play(experiments.hysteresis(
                      level_count=8, harmonic_period_s=0.5), 1, 1000.0, stage=stage)}
    result = refine(replace(wrong, creep=plant.creep, effects=effects), recordings)
    assert result.model.effects == effects
    assert result.model.dynamics.mode_frequencies_rad_per_s == pytest.approx(
        plant.dynamics.mode_frequencies_rad_per_s, rel=2e-3)
    assert result.model.dynamics.time_constant_s == pytest.approx(4.9e-4, rel=0.02)


def test_hysteretic_creep_is_left_out_where_there_is_none(refined):
    assert refined.model.hysteretic_creep is None


def test_a_stage_with_hysteretic_creep_predicts_its_own_recording(branchy, play):
    recording = play(
        experiments.hysteresis(level_count=3), clock_hz=1000.0, stage=branchy, noise_um=0.0,
    )
    prediction = predict(branchy, recording)
    assert np.abs(prediction.measured_um - prediction.simulated_um).max() < 1e-3


def test_the_work_can_be_ended_between_its_steps(plant, recordings):
    fractions = []

    def end(fraction):
        fractions.append(fraction)
        if len(fractions) == 2:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        refine(plant, {"creep": recordings["creep"]}, end)
    assert 0.0 <= fractions[0] < fractions[1] < 1.0


def test_nothing_to_refine_on_and_too_short_a_recording_are_refused(plant, recordings):
    with pytest.raises(ValueError, match="no recording"):
        refine(plant, {})
    part = played(recordings["creep"])
    short = part.select(np.arange(part.voltage_v.size) < 100)
    with pytest.raises(ValueError, match="record longer"):
        refine(plant, {"creep": short})


def test_the_command_stores_the_errors_before_and_after(
    plant, play, recordings, csv_of, tmp_path, capsys, monkeypatch
):
    hysteresis = plant.hysteresis
    doubtful = DensityEstimate(
        "doubtful", hysteresis.levels_v, 1.02 * hysteresis.density_um_per_v2, hysteresis.offset_um,
        visited=np.tril(np.ones_like(hysteresis.density_um_per_v2, dtype=bool)))
    monkeypatch.setattr(estimated_loops, "estimate_hysteresis_of", lambda *_, **__: doubtful)
    unseen = play(experiments.hysteresis(level_count=5, harmonic_period_s=1.0), 3, 1000.0)
    files = {"hysteresis": recordings["hysteresis"], "validation": unseen}
    arguments = []
    for name, recording in files.items():
        arguments += [f"--{name}", str(csv_of(recording, tmp_path / f"{name}.csv"))]
    model = tmp_path / "model.json"
    assert identify_main([*arguments, "--refine", "--no-report", "--output", str(model)]) == 0
    assert "before_refinement.e_y_percent" in capsys.readouterr().out
    errors = load_model(model).errors
    assert errors["refinement_kept"] == 1.0
    assert errors["after_refinement"]["e_y_percent"] == errors["e_y_percent"]
    assert errors["e_y_percent"] < 0.5 * errors["before_refinement"]["e_y_percent"]
    held_out = errors["held_out_e_y_percent"]
    assert held_out["after_refinement"]["hysteresis"] < held_out["before_refinement"]["hysteresis"]
