# SPDX-License-Identifier: BSD-3-Clause
"""The identification node plays its experiments on the stage and has them recorded."""

import json

import numpy as np
import pytest
from action_msgs.msg import GoalStatus

from piezo_client.client import GoalFailed
from piezo_identification.experiments.catalogue import EXPERIMENTS, named_experiment
from piezo_identification.experiments.probing.probe_file import NAME, load_probe
from piezo_identification.experiments.relay_feedback import relay_oscillation
from piezo_identification.recording_check.check import check_recording
from piezo_recorder.reading.reader import read_recording


def assert_recorded_as_designed(path, designed):
    """The recording holds every value of an experiment, the truth and the parameters."""
    recording = read_recording(path)
    assert recording.complete
    assert recording.gaps == []
    played = recording.select(recording.playing)
    assert played.sample_period_s == designed.sample_period_s
    # The last block may be filled up with the last value.
    designed_v = np.tile(designed.voltage_v, designed.repeats)
    assert np.allclose(played.voltage_v[:len(designed_v)], designed_v, rtol=1e-12, atol=1e-12)
    assert np.allclose(played.voltage_v[len(designed_v):], designed_v[-1])
    assert recording.voltage_v[-1] == 0.0
    assert json.loads(recording.attachments["parameters.json"])["experiment"] == designed.name

    truth = read_recording(path, topic="ground_truth")
    fast = recording.sample_periods_s == recording.sample_periods_s.min()
    at = np.isin(recording.sample_index, truth.sample_index)
    assert np.array_equal(recording.sample_index[at], truth.sample_index)
    assert at.sum() >= (fast.sum() if designed.sample_period_s == 25e-6 else 40)
    noise_um = recording.displacement_um[at] - truth.displacement_um
    assert 0.0 < noise_um.std() < 0.02  # 0.009 um RMS and 16 bits


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_experiments_of_the_identification_are_recorded_as_designed(identification, name):
    path, = (path for path in identification.recordings if path.name == name)
    probe = path.with_name(NAME)
    assert_recorded_as_designed(path, named_experiment(
        name, parameters=load_probe(probe).fitted(name) if probe.exists() else {}))


@pytest.mark.parametrize("name", [
    "multisine", *(pytest.param(name, marks=pytest.mark.long) for name in (
        *EXPERIMENTS, "diagnostic"))])
def test_experiment_alone_is_recorded_as_designed_and_tells_how_far_it_is(suite, tmp_path, name):
    told = []
    result = suite.run_experiment(name, tmp_path, on_feedback=told.append)
    assert result.recording == str(tmp_path / name)
    assert result.summary
    assert_recorded_as_designed(result.recording, named_experiment(name))
    assert all(feedback.stage.startswith(f"{name}: ") for feedback in told)
    fractions = [feedback.fraction for feedback in told]
    assert fractions == sorted(fractions)
    assert all(0.0 <= fraction <= 1.0 for fraction in fractions)
    assert all(feedback.seconds_left >= 0.0 for feedback in told)


@pytest.mark.long
def test_distortion_experiment_separates_the_noise_of_the_sensor_from_the_hysteresis(
        suite, tmp_path):
    recording = read_recording(suite.run_experiment("distortion", tmp_path).recording)
    designed = named_experiment("distortion")
    found = check_recording(recording).distortion
    assert found.periods == designed.repeats - 1
    # White noise of variance s^2 has the power 4 s^2 / N at each line.
    noise_um = np.sqrt(np.median(found.noise_um**2) / 4.0 * designed.voltage_v.size)
    assert noise_um == pytest.approx(0.009, rel=0.3)
    # Hysteresis is odd about the middle of its loops; the stage's is nearly so.
    assert found.odd_um > 10.0 * found.significant_um
    assert found.even_um < 0.5 * found.odd_um


def test_unknown_experiment_is_refused_and_nothing_moves(suite, tmp_path):
    before = suite.play([0.0]).last_sample
    with pytest.raises(GoalFailed) as failure:
        suite.run_experiment("creeep", tmp_path)
    assert failure.value.result.message.startswith(
        "unknown experiment 'creeep': choose one of creep, dynamics, hysteresis, validation, "
        "multisine, relay")
    assert list(tmp_path.iterdir()) == []
    assert suite.play([0.0]).first_sample == before + 1


def test_place_where_nothing_can_be_recorded_is_refused_and_nothing_moves(suite, tmp_path):
    before = suite.play([0.0]).last_sample
    (tmp_path / "file").touch()
    with pytest.raises(GoalFailed, match=str(tmp_path / "file")) as failure:
        suite.run_experiment("dynamics", tmp_path / "file")
    assert "Errno" not in failure.value.result.message
    assert suite.play([0.0]).first_sample == before + 1


def test_second_goal_is_refused_while_one_runs_and_the_first_goes_on(suite, endless):
    goal = suite.begin("run_experiment", experiment="dynamics", directory=str(endless))
    with pytest.raises(GoalFailed, match="rejected the goal: it is busy"):
        suite.goal("identify", directory=str(endless))
    with pytest.raises(GoalFailed, match="the stage is busy"):
        suite.play([1.0])
    seen = len(suite.blocks)
    suite.until(lambda: len(suite.blocks) > seen)
    status, result = suite.cancel(goal)
    assert status == GoalStatus.STATUS_CANCELED, result.message
    assert {path.name for path in endless.iterdir()} == {"probe.json", "dynamics"}
    assert read_recording(result.recording).gaps == []


def test_cancelled_experiment_ramps_to_rest_and_keeps_its_recording(suite, endless):
    told = []
    goal = suite.send_goal("run_experiment", on_feedback=told.append, experiment="dynamics",
                           directory=str(endless))
    suite.until(lambda: any("play" in feedback.stage for feedback in told))
    status, result = suite.cancel(goal)
    assert status == GoalStatus.STATUS_CANCELED
    assert (result.success, result.message) == (False, "cancelled")
    recording = read_recording(result.recording)
    assert recording.complete
    assert recording.gaps == []
    assert recording.playing.sum() > 0
    assert recording.voltage_v[-1] == 0.0


def test_experiment_cancelled_at_once_leaves_the_stage_at_rest(suite, endless):
    goal = suite.send_goal("run_experiment", experiment="dynamics", directory=str(endless))
    status, result = suite.cancel(goal)
    assert status == GoalStatus.STATUS_CANCELED
    assert (result.success, result.message) == (False, "cancelled")


def test_emergency_stop_ends_an_experiment_whose_recording_stays_readable(suite, endless):
    goal = suite.begin("run_experiment", experiment="dynamics", directory=str(endless))
    assert suite.trigger("emergency_stop").success
    status, result = suite.result(goal)
    assert status == GoalStatus.STATUS_ABORTED
    assert result.message == "emergency stop"
    recording = read_recording(result.recording)
    assert recording.complete
    assert recording.gaps == []
    assert suite.trigger("reset").success


def test_experiment_is_refused_while_the_stage_plays_something_else(suite, tmp_path):
    goal = suite.begin_play(np.full(4000, 60.0), repeats=1_000_000)
    with pytest.raises(GoalFailed, match=r"waveform refused: the stage is busy"):
        suite.run_experiment("dynamics", tmp_path)
    status, _ = suite.cancel(goal)
    assert status == GoalStatus.STATUS_CANCELED


@pytest.mark.long
def test_relay_oscillates_in_feedback_and_tells_the_ultimate_gain(suite, tmp_path):
    told = []
    result = suite.run_experiment("relay", tmp_path, on_feedback=told.append)
    experiment = named_experiment("relay")
    recording = read_recording(result.recording)
    assert recording.gaps == []
    assert recording.voltage_v[-1] == 0.0
    tracked = recording.select(recording.tracking)
    planned_v = experiment.feedforward_v
    assert np.array_equal(tracked.voltage_v[: planned_v.size], planned_v)
    assert np.abs(tracked.voltage_v[planned_v.size :] - planned_v[-1]).max() <= 7.0 + 1e-9
    oscillation = relay_oscillation(recording, experiment)
    assert oscillation.summary in result.summary
    assert "declared delay of 2.01 ms" in result.summary
    # What the loop's delay leaves to the phase of the stage, but for switching in whole ticks.
    phase_deg = np.degrees(np.angle(oscillation.response_um_per_v[0]))
    delayed_deg = 360.0 * oscillation.frequency_hz * experiment.delay_s
    tick_deg = 360.0 * oscillation.frequency_hz * experiment.tick_s
    assert abs(delayed_deg - phase_deg - 180.0) < 0.6 * tick_deg
    fractions = [feedback.fraction for feedback in told]
    assert fractions == sorted(fractions)
    assert {feedback.stage for feedback in told} <= {"relay: feedback"}


def test_cancelled_relay_ramps_to_rest_and_keeps_its_recording(suite, endless):
    goal = suite.begin("run_experiment", experiment="relay", directory=str(endless))
    status, result = suite.cancel(goal)
    assert status == GoalStatus.STATUS_CANCELED
    assert (result.success, result.message) == (False, "cancelled")
    recording = read_recording(result.recording)
    assert recording.gaps == []
    assert recording.voltage_v[-1] == 0.0
    assert suite.play([0.0]).success


def test_emergency_stop_ends_a_relay(suite, endless):
    goal = suite.begin("run_experiment", experiment="relay", directory=str(endless))
    assert suite.trigger("emergency_stop").success
    status, result = suite.result(goal)
    assert status == GoalStatus.STATUS_ABORTED
    assert "stopped before the end" in result.message
    suite.until(lambda: suite.trigger("reset").success)
