# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import replace

import numpy as np
import pytest

from piezo_identification.conditioning.waveforms import slow_branches
from piezo_identification.experiments import catalogue as experiments
from piezo_identification.prediction import predict, unseen_errors
from piezo_models import CreepDynamics, ElectricVibrationDynamics, PreisachModel, StageModel
from piezo_models.effects.backlash import Backlash
from piezo_recorder import recording_of


@pytest.mark.parametrize("experiment, clock_hz", [
    (experiments.validation(arc_s=0.1, tones_s=0.2), 40_000.0),
    (experiments.hysteresis(level_count=3), 4000.0),
])
def test_the_plant_predicts_its_own_recording_whatever_crept_before(
    plant, play, experiment, clock_hz
):
    memory = plant.memory()
    plant.simulate(np.full(40_000, 120.0), 1e-3, memory)
    recording = play(experiment, clock_hz=clock_hz, memory=memory, noise_um=0.0)
    prediction = predict(plant, recording)
    assert np.abs(prediction.measured_um - prediction.simulated_um).max() < 1e-5


def test_slow_ringing_behind_a_rest_is_predicted_from_the_first_row_on():
    dynamics = ElectricVibrationDynamics(0.0, (30.0,), (0.1,))
    model = StageModel(PreisachModel.line(0.0, 10.0, 2.0), CreepDynamics(), dynamics)
    voltage_v = np.where(np.arange(2000) < 50, 0.0, 8.0)
    noise_um = 1e-4 * np.random.default_rng(7).normal(size=2000)
    measured_um = model.simulate(voltage_v, 1e-3) + noise_um

    def recording(first):
        return recording_of({"time_s": 1e-3 * np.arange(first, 2000),
                             "voltage_v": voltage_v[first:],
                             "displacement_um": measured_um[first:]})

    prediction = predict(model, recording(0))
    assert prediction.time_s.size == 2000
    assert np.std(prediction.measured_um - prediction.simulated_um) < 2e-4
    assert predict(model, recording(100)).time_s.size < 1900


def test_errors_on_unseen_data_tell_hysteresis_from_dynamics(plant, play):
    recording = play(experiments.validation(arc_s=0.1, tones_s=0.2), noise_um=0.0)
    wrong = type(plant)(
        plant.hysteresis, plant.creep, type(plant.dynamics)(0.00049, (2846.0, 4800.0), (0.685, 0.1))
    )
    errors = unseen_errors(wrong, recording)
    assert set(errors) == {"e_y_percent", "hysteresis_e_y_percent", "dynamics_e_y_percent"}
    assert errors["hysteresis_e_y_percent"] < 0.1
    assert errors["dynamics_e_y_percent"] > 1.0


def test_no_error_is_told_of_branches_that_do_not_move(plant, play):
    """A rest is one slow branch, and a last row that jumps back is a fast one."""
    turns = np.arange(4000) / 20.0
    cycles_v = 10.0 + turns / 5.0 * (1.0 - np.cos(2.0 * np.pi * turns))
    wave_v = np.concatenate([np.full(1000, 10.0), cycles_v, [90.0]])
    recording = play(experiments.Experiment("cycles", wave_v, 1e-3, 1, "rest, cycles, a jump"),
                     clock_hz=1000.0)
    recording = recording.select(recording.playing)
    assert set(unseen_errors(plant, recording)) == {"e_y_percent", "dynamics_e_y_percent"}


def test_slow_branches_are_those_between_distant_reversals():
    time_s = np.arange(4000) * 1e-3
    voltage_v = np.where(
        time_s < 2.0, np.cos(2.0 * np.pi * time_s), np.cos(2.0 * np.pi * 50.0 * time_s)
    )
    slow = slow_branches(time_s, voltage_v)
    assert slow[:1990].all()
    assert not slow[2020:].any()


def test_a_recording_too_short_to_settle_is_refused(plant, play):
    recording = play(experiments.validation(arc_s=0.1, tones_s=0.2))
    start = np.argmax(recording.playing)
    short = recording.select(np.arange(recording.voltage_v.size) < start + 5)
    with pytest.raises(ValueError, match="record longer"):
        predict(plant, short)


def test_a_recording_that_begins_anywhere_is_predicted_from_the_past_that_fits_best(plant, play):
    memory = plant.memory()
    plant.simulate(np.repeat([103.0, 0.0], 200_000), 1e-3, memory)
    turns_v = np.array([55.0, 95.0, 20.0, 115.0, 0.0, 60.0])
    ways = [np.linspace(*ends, 400) for ends in zip(turns_v[:-1], turns_v[1:], strict=True)]
    wander = experiments.Experiment("wander", np.concatenate(ways), 1e-3, 1, "wander")
    recording = play(wander, clock_hz=1000.0, memory=memory, noise_um=0.0)
    recording = recording.select(recording.playing)
    prediction = predict(plant, recording)
    assert prediction.past_v == pytest.approx((103.0, 0.0), abs=5.0)
    assert prediction.e_y_percent() < 0.05
    from_below = predict(plant, play(experiments.validation(arc_s=0.05), 1))
    assert from_below.past_v == ()


@pytest.mark.parametrize(("centre_v", "first_v"), [(40.0, 40.0), (70.0, 70.0), (60.0, 35.0)])
def test_a_demagnetised_stage_is_predicted_from_its_first_row_on(plant, centre_v, first_v):
    stage = StageModel(plant.hysteresis, CreepDynamics(), ElectricVibrationDynamics())
    swings_v = centre_v + 60.0 * np.linspace(1.0, 0.0, 20_000) * np.sin(np.arange(20_000))
    turns_v = np.array([first_v, 80.0, 30.0, 65.0, 5.0, 60.0])
    voltage_v = np.concatenate([
        np.linspace(*ends, 300) for ends in zip(turns_v[:-1], turns_v[1:], strict=True)])
    displacement_um = stage.simulate(np.append(swings_v, voltage_v), 0.01)[swings_v.size :]
    recording = recording_of({"time_s": 0.01 * np.arange(voltage_v.size), "voltage_v": voltage_v,
                              "displacement_um": displacement_um})
    assert predict(stage, recording).e_y_percent() < 0.02


def test_a_play_begins_at_the_rest_before_the_recording(plant, play):
    """The ramp to the first voltage takes up the play of the plant."""
    worn = replace(plant, effects=(Backlash(0.5),))
    recording = play(experiments.creep(period_s=20.0), noise_um=0.0, stage=worn)
    assert predict(worn, recording).e_y_percent() < 0.1
