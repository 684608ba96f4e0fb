# SPDX-License-Identifier: BSD-3-Clause
"""Verdicts on components of known truth: the stage itself is the model, or lacks something."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from piezo_identification.adequacy.component_adequacy import (
    adequacy_document,
    adequacy_of,
    adequacy_table,
    overall_verdict,
    unseen_errors_beyond_noise,
)
from piezo_identification.adequacy.component_residual import component_residual
from piezo_identification.adequacy.lack_of_fit import lack_of_fit
from piezo_identification.estimators.dynamics.fast_estimate import WARM_UP_S
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_identification.experiments import catalogue as experiments
from piezo_models.cascade import StageModel
from piezo_models.effects.delay import Delay
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder import recording_of

NOISE_UM = 0.009
PERIODS = 100


@pytest.fixture(scope="module")
def recordings(play):
    return {
        "creep": play(experiments.creep(), 1, 100.0),
        "dynamics": play(experiments.dynamics(), 2),
        "hysteresis": play(experiments.hysteresis(level_count=20), 3, 1000.0),
    }


def test_the_stage_itself_is_adequate_and_its_noise_is_found(plant, recordings):
    adequacy = adequacy_of(plant, recordings)
    assert {part.verdict for part in adequacy.values()} == {"adequate"}
    true_um = {"creep": NOISE_UM / np.sqrt(400.0), "hysteresis": NOISE_UM / np.sqrt(40.0),
               # The first 0.3 s of 100 periods are not used.
               "dynamics": NOISE_UM / np.sqrt(0.85 * PERIODS)}
    for component, part in adequacy.items():
        assert part.noise_rms_um == pytest.approx(true_um[component], rel=0.1)
        assert part.ratio == pytest.approx(1.0, abs=0.1)
        assert (part.left, part.advice) == ("", "")
    assert overall_verdict(adequacy_document(adequacy)) == "adequate"
    assert adequacy["dynamics"].noise_from == "repeats"


@pytest.mark.parametrize("error, ratio", [(0.0, 1.0), (1e-3, 1e15)])
def test_a_recording_without_noise_has_a_finite_ratio(error, ratio):
    line = PreisachModel.line(0.0, 10.0, 2.0)
    model = StageModel(line, CreepDynamics(), ElectricVibrationDynamics())
    voltage_v = np.tile(np.concatenate([np.arange(0.0, 10.0, 0.1), np.arange(10.0, 0.0, -0.1)]), 3)
    part = adequacy_of(model, {"hysteresis": recording_of({
        "time_s": 0.01 * np.arange(voltage_v.size), "voltage_v": voltage_v,
        "displacement_um": 2.0 * voltage_v + error * voltage_v**2})})["hysteresis"]
    assert np.isfinite(part.ratio) and part.ratio >= ratio
    assert part.verdict == ("inadequate" if error else "adequate")


def test_rows_before_the_first_used_step_are_in_no_mean_of_periods(plant, recordings):
    residual = component_residual("dynamics", plant, recordings["dynamics"])
    assert residual.time_s[0] >= WARM_UP_S
    assert residual.good.all()
    assert residual.residual_um.size > 80 * residual.period


@pytest.mark.parametrize("lacks_hysteresis", [False, True])
def test_an_error_on_the_validation_far_above_the_noise_is_told(
        plant, recordings, lacks_hysteresis):
    model = replace(plant, hysteresis=PreisachModel.line(-20.0, 120.0, 1.0)) if (
        lacks_hysteresis) else plant
    unseen = {"creep": recordings["creep"], "validation": recordings["hysteresis"]}
    told = unseen_errors_beyond_noise(model, unseen, {})
    assert len(told) == lacks_hysteresis
    if told:
        assert recordings["hysteresis"].path in told[0]


@pytest.mark.parametrize("seeds", [range(10), pytest.param(range(10, 110), marks=pytest.mark.long)],
                         ids=["some", "many"])
def test_noise_alone_is_hardly_ever_called_inadequate(plant, play, seeds):
    adequate = [
        adequacy_of(plant, {"dynamics": play(experiments.dynamics(duration_s=1.0), seed)})[
            "dynamics"].verdict == "adequate" for seed in seeds]
    assert np.mean(adequate) >= 0.99


def test_slow_noise_of_the_sensor_is_told_by_repeats(plant, play):
    """A sensor of 1 kHz bandwidth: its noise is white nowhere in the sampled band."""
    recording = play(experiments.dynamics(), 1, noise_um=0.0)
    white = np.random.default_rng(5).normal(size=recording.voltage_v.size)
    slow_um = 0.02 * lfilter([0.15], [1.0, -0.85], white)
    noisy = replace(recording, displacement_um=recording.displacement_um + slow_um)
    part = adequacy_of(plant, {"dynamics": noisy})["dynamics"]
    assert part.verdict == "adequate"
    assert part.noise_rms_um == pytest.approx(np.std(slow_um) / np.sqrt(0.85 * PERIODS), rel=0.15)


@pytest.mark.parametrize("hidden", [
    {"effects": (Delay(1e-4),)},
    {"dynamics": ElectricVibrationDynamics(
        0.00049, (2846.0, 4909.0, 8800.0), (0.685, 0.082, 0.02))},
], ids=["a delay", "a mode"])
def test_what_the_dynamics_lack_is_told_with_its_size_and_place(plant, play, hidden):
    stage = replace(plant, **hidden)
    quiet, noisy = (play(experiments.dynamics(), 1, stage=stage, noise_um=noise_um)
                    for noise_um in (0.0, NOISE_UM))
    truth_um = lack_of_fit(component_residual("dynamics", plant, quiet)).residual_rms_um
    part = adequacy_of(plant, {"dynamics": noisy})["dynamics"]
    assert part.verdict == "inadequate"
    assert part.residual_rms_um == pytest.approx(truth_um, rel=0.01)
    assert "after the steps" in part.left
    assert "let diagnose name the cause" in part.advice


def test_rows_that_are_read_late_are_no_lack_of_the_dynamics(plant, play):
    period_s = 25e-6
    late = play(experiments.dynamics(), 1, stage=replace(plant, effects=(Delay(0.6 * period_s),)))
    # Of a row on, that is read two fifths of a period after the voltage.
    read = replace(late, displacement_um=np.roll(late.displacement_um, -1)).select(
        np.arange(late.voltage_v.size) < late.voltage_v.size - 1)
    verdicts = [adequacy_of(plant, {"dynamics": read}, delays)["dynamics"].verdict
                for delays in ({}, {"dynamics": -0.4 * period_s})]
    assert verdicts == ["inadequate", "adequate"]


def test_a_mode_is_found_at_its_frequency_and_the_search_for_the_order_is_advised(
        plant, play, recordings):
    stage = replace(plant, dynamics=ElectricVibrationDynamics(
        0.00049, (2846.0, 4909.0), (0.685, 0.02)))
    model = replace(plant, dynamics=ElectricVibrationDynamics(0.00049, (2846.0,), (0.685,)))
    fast = play(experiments.dynamics(), 1, stage=stage)
    part = adequacy_of(model, {"dynamics": fast, "hysteresis": recordings["hysteresis"]},
                       asked_for=["dynamics"])["dynamics"]
    near_hz = float(part.left.split("near ")[1].split(" Hz")[0])
    assert near_hz == pytest.approx(4909.0 / 2.0 / np.pi, rel=0.1)
    assert "leave --modes out" in part.advice


def test_creep_that_is_a_tenth_too_fast_is_inadequate(plant, recordings):
    poles, zeros = plant.creep.poles_rad_per_s, plant.creep.zeros_rad_per_s
    wrong = CreepDynamics((1.1 * poles[0], *poles[1:]), (1.1 * zeros[0], *zeros[1:]))
    part = adequacy_of(replace(plant, creep=wrong), {"creep": recordings["creep"]})["creep"]
    assert part.verdict == "inadequate"
    assert part.advice.startswith("record the creep longer, or let diagnose")


@pytest.fixture
def bent(recordings):
    """Loops with a bump about 90 V, on the way up and down."""
    recording = recordings["hysteresis"]
    bump_um = 0.05 * np.exp(-(((recording.voltage_v - 90.0) / 4.0) ** 2))
    return replace(recording, displacement_um=recording.displacement_um + bump_um)


def test_loops_that_the_model_misses_are_told_by_voltage(plant, bent):
    part = adequacy_of(plant, {"hysteresis": bent})["hysteresis"]
    assert part.verdict == "inadequate"
    low_v, high_v = (float(word) for word in part.left.split(" and ")[1].split(" V")[0].split(
        " to "))
    assert low_v < 90.0 < high_v
    table = adequacy_table(adequacy_document({"hysteresis": part}))
    assert "hysteresis is inadequate" in table


def test_every_recording_of_a_component_is_tested_but_for_a_few_samples(plant, recordings, bent):
    recording = recordings["hysteresis"]
    short = recording.select(np.arange(recording.voltage_v.size) < 10)
    adequacy = adequacy_of(
        plant, {"hysteresis": recording, "hysteresis 2": bent, "hysteresis 3": short})
    assert {name: part.verdict for name, part in adequacy.items()} == {
        "hysteresis": "adequate", "hysteresis 2": "inadequate"}
    document = adequacy_document(adequacy)
    assert overall_verdict(document) == "inadequate"
    assert "hysteresis 2 is inadequate" in adequacy_table(document)


def test_a_frequency_response_is_judged_too(plant):
    frequency_hz = np.geomspace(2.0, 2000.0, 200)
    noise = np.random.default_rng(3).normal(size=(2, 200)) * 1e-3
    gain = 2.0 * plant.response(frequency_hz) + noise[0] + 1j * noise[1]
    verdicts = [
        adequacy_of(plant, {"dynamics": FrequencyResponse("r", frequency_hz, shown)})["dynamics"]
        for shown in (gain, gain * np.exp(-2j * np.pi * frequency_hz * 1e-4))]
    assert [part.verdict for part in verdicts] == ["adequate", "inadequate"]
    low_um, high_um = plant.hysteresis.output_range_um
    assert verdicts[0].noise_rms_um == pytest.approx(0.5e-3 * (high_um - low_um), rel=0.1)


def test_without_noise_only_what_matters_is_inadequate(plant, play):
    quiet = play(experiments.hysteresis(level_count=20), 3, 1000.0, noise_um=0.0)
    assert adequacy_of(plant, {"hysteresis": quiet})["hysteresis"].verdict == "adequate"


def test_the_recording_that_is_missing_is_asked_for(plant, recordings):
    static = replace(plant, creep=CreepDynamics(), dynamics=ElectricVibrationDynamics())
    loops = {"hysteresis": recordings["hysteresis"]}
    advice = adequacy_of(static, loops)["hysteresis"].advice
    assert f"give a recording for --creep, if only {recordings['hysteresis'].path} once more" in (
        advice)
    advice = adequacy_of(static, recordings)["hysteresis"].advice
    assert "give a recording" not in advice
