# SPDX-License-Identifier: BSD-3-Clause
import json
from dataclasses import replace

import numpy as np
import pytest

from piezo_identification.commands.diagnose_command import main
from piezo_identification.conditioning.waveforms import played
from piezo_identification.diagnosis.comparison.criteria import significance
from piezo_identification.diagnosis.diagnose import diagnose
from piezo_identification.diagnosis.evidence.effect_entries import effect_entries
from piezo_identification.diagnosis.report.diagnosis_report import (
    render_report,
    verdict_sentence,
)
from piezo_identification.experiments import catalogue as experiments
from piezo_identification.fitting.dataset import simulate_recordings
from piezo_identification.fitting.free_parameters import changed_model, free_sensitivities
from piezo_identification.fitting.noise_estimate import residual_um
from piezo_identification.fitting.parameter_sensitivities import (
    parameter_sensitivities,
    perturbed,
)
from piezo_identification.fitting.regression import (
    first_regression,
    fit_without_effects,
    reweighted,
)
from piezo_identification.prediction import predict
from piezo_identification.simulation.past_search import simulated_recording
from piezo_models.effects.backlash import Backlash
from piezo_models.effects.delay import Delay
from piezo_models.effects.periodic_disturbance import PeriodicDisturbance
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.effects.voltage_clipping import VoltageClipping
from piezo_models.hysteresis.first_rise import FirstRise
from piezo_models.hysteresis.hysteretic_creep import HystereticCreep
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import load_model, save_model

MODE = VibrationMode(2.0 * np.pi * 1400.0, 0.03, 0.5)


@pytest.fixture(scope="module")
def record(plant, play):
    def record_with(*effects, seed=1, **options):
        experiment = experiments.validation(arc_s=0.015, tones_s=0.06)
        return play(experiment, seed, stage=replace(plant, effects=effects), **options)

    return record_with


@pytest.fixture(scope="module")
def of_mode(plant, record):
    return diagnose(plant, [record(MODE)])


def test_the_plant_with_effects_predicts_its_own_recording(plant, record):
    effects = (VoltageClipping(-20.0, 90.0), MODE, Delay(5e-5))
    prediction = predict(replace(plant, effects=effects), record(*effects, noise_um=0.0))
    assert np.abs(prediction.measured_um - prediction.simulated_um).max() < 1e-5


def test_noise_is_noise(plant, record):
    diagnosis = diagnose(plant, [record()])
    assert (diagnosis.verdict, diagnosis.effects, diagnosis.left) == ("none", [], "")
    assert diagnosis.model is plant
    assert diagnosis.before == diagnosis.after


@pytest.mark.usefixtures("likely_effects")
def test_where_only_other_parameters_leave_noise_the_extended_model_has_them(plant, record):
    off = replace(plant, dynamics=replace(
        plant.dynamics, time_constant_s=1.03 * plant.dynamics.time_constant_s))
    diagnosis = diagnose(off, [record()])
    assert (diagnosis.verdict, diagnosis.effects) == ("none", [])
    assert diagnosis.after["rms_um"] < 2.0 * diagnosis.noise_floor_um < diagnosis.before["rms_um"]
    assert "estimated again" in verdict_sentence(diagnosis)


@pytest.mark.kernels
def test_a_missing_mode_is_found_and_its_parameters_are_those_of_the_plant(of_mode):
    assert of_mode.verdict == "explained"
    first = of_mode.effects[0]
    assert first["name"] == "vibration_mode"
    for name, value in MODE.parameters().items():
        error = abs(first["parameters"][name] - value)
        assert error < 0.02 * value
        assert error < 10.0 * first["standard_deviations"][name]
    assert of_mode.after["rms_um"] < 1.1 * of_mode.noise_floor_um < 0.5 * of_mode.before["rms_um"]


def test_beside_a_stronger_effect_one_below_the_noise_is_a_stand_in(plant, record):
    """The noise is 8.8 nm, and the width of the play about what it contributes."""
    regression = first_regression(simulate_recordings(plant, [record(MODE)]))
    for effects, are_named in [((MODE, Backlash(1e-3)), (True, False)),
                               ((MODE, Backlash(0.1)), (True, True)),
                               ((Backlash(1e-3),), (True,))]:
        entries = effect_entries(regression, regression.fit(effects))
        assert tuple("stand_in" not in entry for entry in entries) == are_named


def test_the_extended_model_is_better_on_another_recording(plant, of_mode, record):
    unseen = record(MODE, seed=2)
    before, after = (predict(model, unseen).e_y_percent() for model in (plant, of_mode.model))
    assert after < 0.3 * before


@pytest.mark.long
@pytest.mark.kernels
def test_two_effects_are_found_one_after_the_other(plant, record):
    diagnosis = diagnose(plant, [record(PeriodicDisturbance(333.3, 0.05, 0.02), Delay(8e-5))])
    assert diagnosis.verdict == "explained"
    assert {entry["name"] for entry in diagnosis.effects} == {"periodic_disturbance", "delay"}
    strengths = [entry["error_reduction_percent"] for entry in diagnosis.effects]
    assert strengths == sorted(strengths, reverse=True)


@pytest.mark.usefixtures("likely_effects")
@pytest.mark.parametrize("part_of_span", [
    0.02, pytest.param(0.0, marks=pytest.mark.long)])
def test_a_soft_limit_is_found_below_and_at_the_highest_voltage(
        plant, record, part_of_span):
    voltage_v = record().voltage_v
    highest_v = voltage_v.max() - part_of_span * np.ptp(voltage_v)
    diagnosis = diagnose(plant, [record(VoltageClipping(-60.0, highest_v, 2.0))])
    assert [entry["name"] for entry in diagnosis.effects] == ["voltage_clipping"]
    assert diagnosis.effects[0]["parameters"]["highest_v"] == pytest.approx(highest_v, abs=1.0)


@pytest.fixture(scope="module")
def of_levels(plant, play):
    """Return few levels, held for seconds, by an amplifier that bends off below the highest."""
    limit = VoltageClipping(-60.0, 74.0, 2.0)
    levels_v = np.repeat([74.0, 38.0, 30.0, 74.0, 35.0, 52.0, 62.0], 2000)
    experiment = experiments.Experiment("levels", levels_v, 1e-3, 1, "")
    return limit, play(experiment, 1, 1000.0, stage=replace(plant, effects=(limit,)))


def test_an_effect_on_the_voltage_acts_on_what_the_hysteresis_remembers(plant, of_levels):
    limit, recording = of_levels
    beside = predict(replace(plant, effects=(limit,)), recording)
    assert np.std(beside.measured_um - beside.simulated_um) < 1.1 * 0.009
    dataset = simulate_recordings(plant, [recording], past_v=())
    left = residual_um(dataset, 0, (limit,))[dataset.simulated[0].begin :]
    assert np.std(left) < 1.1 * 0.009


@pytest.mark.long
def test_no_past_is_made_up_to_explain_an_effect(plant, of_levels):
    limit, recording = of_levels
    diagnosis = diagnose(plant, [recording])
    assert [entry["name"] for entry in diagnosis.effects] == ["voltage_clipping"]
    assert diagnosis.effects[0]["parameters"]["highest_v"] == pytest.approx(limit.highest_v, abs=1)
    assert diagnosis.selection.regression.dataset.simulated[0].past_v == ()


def test_the_prior_of_the_parameters_goes_with_what_is_left_beside_the_effects(plant, record):
    regression = first_regression(simulate_recordings(plant, [record(MODE)]))
    before = regression.residual_um(regression.fit(()))
    beside = reweighted(regression, (MODE,))
    assert regression.residual_um(regression.fit(())) == before
    assert beside.residual_um(beside.fit(())) < 0.8 * before
    assert beside.residual_um(fit_without_effects(beside)) == pytest.approx(before, rel=0.02)


@pytest.mark.long
def test_a_line_that_the_voltage_drives_is_no_disturbance(plant, record):
    recording = record()
    time_s = recording.time_s - recording.time_s[0]
    wave = replace(recording, voltage_v=50.0 - 40.0 * np.cos(2.0 * np.pi * 15.0 * time_s))
    simulated_um = predict(plant, wave).simulated_um
    fading = np.linspace(0.998, 1.002, simulated_um.size) * simulated_um
    missing = wave.voltage_v.size - fading.size
    played_um = np.r_[np.full(missing, fading[0]), fading]
    noise_um = np.random.default_rng(0).normal(scale=0.009, size=played_um.size)
    diagnosis = diagnose(plant, [replace(wave, displacement_um=played_um + noise_um)])
    assert "periodic_disturbance" not in [entry["name"] for entry in diagnosis.effects]


@pytest.mark.usefixtures("without_ceiling")
def test_what_no_candidate_explains_gets_no_name(plant, record):
    recording = record()
    generator = np.random.default_rng(0)
    wander = np.cumsum(generator.normal(size=recording.voltage_v.size // 50 + 2))
    wander *= 0.1 / np.std(wander[20:] - wander[:-20])
    index = np.arange(recording.voltage_v.size)
    strange = replace(
        recording,
        displacement_um=recording.displacement_um
        + np.interp(index, 50.0 * np.arange(wander.size), wander),
    )
    diagnosis = diagnose(plant, [strange])
    assert diagnosis.verdict == "unexplained"
    assert diagnosis.effects == []
    assert "nm RMS" in diagnosis.left and "Hz" in diagnosis.left


@pytest.mark.parametrize("beside", [
    {},
    {"hysteretic_creep": HystereticCreep((0.0, 5.0), (0.02, 0.1), (0.05, 0.03)),
     "effects": (VoltageClipping(-20.0, 90.0),)},
], ids=["bare", "with_creep_and_limit"])
def test_parameter_sensitivities_are_the_derivatives_by_the_parameters(plant, record, beside):
    recording = record(noise_um=0.0)
    plant = replace(plant, **beside)
    part = simulated_recording(plant, recording)
    rows = np.arange(part.begin, part.time_s.size, 37)
    columns = parameter_sensitivities(part, rows)
    generator = np.random.default_rng(0)
    changes = 0.01 * generator.normal(size=columns.shape[1])
    changes[-1] = abs(changes[-1])  # a reversible part is not negative
    moved, still = (
        simulated_recording(model, recording).simulate()[rows]
        for model in (perturbed(plant, changes), plant)
    )
    linear = columns @ changes
    assert np.abs(moved - still - linear).max() < 0.02 * np.abs(linear).max()


@pytest.mark.parametrize(("derivatives", "changed"), [
    (parameter_sensitivities, perturbed), (free_sensitivities, changed_model)])
def test_derivatives_of_a_stage_that_was_never_cycled(
    plant, record, derivatives, changed,
):
    rising = replace(plant, first_rise=FirstRise((-20.0, 120.0), (0.0, 4.0)))
    part = simulated_recording(rising, record(noise_um=0.0)).after((), -20.0)
    assert np.ptp(part.simulate() - part.with_model(plant).simulate()) > 1.0
    rows = np.arange(part.begin, part.time_s.size, 37)
    columns = derivatives(part, rows)
    changes = 1e-3 * np.abs(np.random.default_rng(0).normal(size=columns.shape[1]))
    moved = part.with_model(changed(rising, changes)).simulate()[rows]
    linear = columns @ changes
    assert np.abs(moved - part.simulate()[rows] - linear).max() < 0.02 * np.abs(linear).max()


def test_what_is_not_reversible_cannot_be_made_irreversible(plant, record):
    """Otherwise the density would gain what no reversible part loses."""
    part = simulated_recording(plant, record(noise_um=0.0))
    changes = np.zeros(parameter_sensitivities(part, np.arange(9)).shape[1])
    changes[-1] = -1.0
    moved = perturbed(plant, changes).hysteresis
    assert moved.output_range_um == pytest.approx(plant.hysteresis.output_range_um)


def test_held_out_stretches_are_not_fitted(plant, record):
    regression = first_regression(simulate_recordings(plant, [record()]))
    assert not (regression.estimation & regression.validation).any()
    assert 0.3 < np.mean(~regression.dataset.for_estimation) < 0.37
    start = regression.fit(())
    assert significance(regression, start, regression.fit((Delay(5e-5),))) < 3.0


def test_no_recording_and_too_short_a_recording_are_refused(plant, record):
    with pytest.raises(ValueError, match="no recording"):
        diagnose(plant, [])
    part = played(record())
    with pytest.raises(ValueError, match="record longer"):
        diagnose(plant, [part.select(np.arange(part.voltage_v.size) < 90)])


@pytest.mark.usefixtures("without_pictures")
def test_the_command_writes_verdict_model_and_report(
    plant, record, csv_of, tmp_path, capsys, page_parts, few_effects,
):
    model, output = tmp_path / "model.json", tmp_path / "out"
    save_model(model, IdentifiedModel(plant, (-20.0, 120.0)))
    files = []
    for seed in (1, 2):
        files.append(str(csv_of(record(MODE, seed=seed), tmp_path / f"{seed}.csv")))
    with few_effects():
        assert main(["--model", str(model), "--data", files[0], "--holdout", files[1],
                     "--output", str(output)]) == 0
    assert "verdict: explained" in capsys.readouterr().out
    verdict = json.loads((output / "verdict.json").read_text())
    assert verdict["effects"][0]["name"] == "vibration_mode"
    assert verdict["holdout"]["source"] == files[1]
    assert verdict["after"]["rms_um"] < 0.3 * verdict["before"]["rms_um"]
    assert load_model(output / "extended_model.json").model.effects[0].name == "vibration_mode"
    page = page_parts(output / "report.html")
    assert {"Residuals", "Residuals over voltage", "Spectra", "Error over frequency",
            "Correlations", "Dependences"} == page.pictures.keys()


@pytest.fixture(scope="module")
def page_of_mode(of_mode):
    return render_report(of_mode)


@pytest.mark.parametrize("device", ["phone", "desk"])
def test_the_report_fits_its_device_and_shows_all_pictures(page_of_mode, page_faults, device):
    assert page_faults(page_of_mode, device) == []


def test_the_command_refuses_bad_input_in_one_line(tmp_path, capsys):
    missing = str(tmp_path / "missing.json")
    assert main(["--model", missing, "--data", missing, "--output", str(tmp_path / "out")]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
