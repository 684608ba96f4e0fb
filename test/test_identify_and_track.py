# SPDX-License-Identifier: BSD-3-Clause
"""The whole way: identify the stage by an action, then track references with its model."""

import json
import math
import re
import signal

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from piezo_interfaces.msg import Reference, SampleBlock

from piezo_client.client import GoalFailed
from piezo_client.overview import status_lines
from piezo_controller.tracking.tracking_run import NOT_FOLLOWED
from piezo_recorder.reading.reader import read_recording, sha256_of

CENTRE_UM = 57.0
GOES_ON_S = 3600.0
"""Of stage time: longer than a test asks while it lasts; the test ends the run."""


def harmonic(frequency_hz=100.0, amplitude_um=40.0, centre_um=CENTRE_UM, **others):
    return {"kind": "harmonic", "frequency_hz": [frequency_hz], "amplitude_um": [amplitude_um],
            "centre_um": centre_um, **others}


def goal_fields(model, directory, reference=None, mode="composite", duration_s=0.5):
    return {"reference": Reference(**(reference or harmonic())), "model": str(model),
            "mode": mode, "duration_s": duration_s, "directory": str(directory)}


# Identify

def test_identification_leaves_a_model_with_its_errors_and_recordings(identification):
    identified = identification.model()
    assert identification.path.parent == identification.recordings[0].parent
    assert identification.errors == pytest.approx(identified.errors)
    assert identified.errors["e_y_percent"] < 0.2  # on data that were not fitted
    assert identification.components == identified.adequacy
    assert list(identified.adequacy) == ["creep", "dynamics", "hysteresis"]
    verdicts = {part["verdict"] for part in identified.adequacy.values()}
    assert identification.adequacy == ("adequate" if verdicts == {"adequate"} else "inadequate")
    assert {entry["sha256"] for entry in identified.recordings} >= {
        sha256_of(path) for path in identification.recordings[:3]}
    assert identified.voltage_range_v == pytest.approx((-20.0, 120.0))


def test_identification_says_where_the_earlier_model_is_kept(identification):
    assert identification.message == "the earlier model is kept as model.previous.json"
    assert identification.path.with_name("model.previous.json").exists()


def test_identification_tells_how_far_it_is(identification, told):
    steps, fractions, seconds_left = zip(*told, strict=True)
    stages = [step.split(":")[0] for step in steps]
    assert list(dict.fromkeys(stages))[-1] == "estimate"
    assert {"creep", "dynamics", "hysteresis", "validation"} <= set(stages)
    assert list(fractions) == sorted(fractions)
    assert 0.0 <= fractions[0] < fractions[-1] <= 1.0
    assert min(seconds_left) >= 0.0


def test_identification_from_a_wrong_number_of_recordings_is_refused(suite, identification):
    recordings = list(map(str, identification.recordings))
    with pytest.raises(GoalFailed, match="2 recordings are named: give those of creep, "):
        suite.goal("identify", recordings=recordings[:2])


def test_identification_from_a_recording_that_is_not_there_is_refused(suite, identification):
    recordings = list(map(str, identification.recordings))
    with pytest.raises(GoalFailed, match="/no/creep does not exist"):
        suite.goal("identify", recordings=["/no/creep", *recordings[1:]])


def test_cancelled_identification_keeps_what_it_recorded(suite, tmp_path):
    goal = suite.begin("identify", directory=str(tmp_path))
    status, result = suite.cancel(goal)
    assert status == GoalStatus.STATUS_CANCELED
    assert (result.message, result.model) == ("cancelled", "")
    recording = read_recording(result.recordings[0])
    assert recording.gaps == []
    assert recording.voltage_v[-1] == 0.0
    assert not list(tmp_path.glob("*.json"))


# Track

@pytest.mark.parametrize(("frequency_hz", "amplitude_um", "largest_e_rms_percent"), [
    (100.0, 40.0, 0.2), (1000.0, 10.25, 0.5)])
def test_composite_control_tracks_within_its_accuracy(
        suite, model, tmp_path, frequency_hz, amplitude_um, largest_e_rms_percent):
    told = []
    result = suite.track(harmonic(frequency_hz, amplitude_um), model, "composite", 0.5, tmp_path,
                         on_feedback=told.append)
    assert result.e_rms_percent <= largest_e_rms_percent
    assert result.missed_feedback == 0
    assert result.largest_error_um < 0.02 * amplitude_um
    fractions = [feedback.fraction for feedback in told]
    assert fractions == sorted(fractions)
    assert all(0.0 <= fraction <= 1.0 for fraction in fractions)
    assert all(feedback.seconds_left >= 0.0 for feedback in told)

    recording = read_recording(result.recording)
    truth = read_recording(result.recording, topic="ground_truth")
    for measured, largest in [(recording, largest_e_rms_percent),
                              (truth, largest_e_rms_percent)]:
        tracked = measured.displacement_um[np.isin(
            measured.sample_index, recording.sample_index[recording.tracking])][-20_000:]
        time_s = np.arange(20_000) / 40_000
        reference_um = CENTRE_UM + amplitude_um / 2 * np.sin(2 * np.pi * frequency_hz * time_s)
        e_rms_percent = 100 * np.sqrt(np.mean((tracked - reference_um)**2)) / amplitude_um
        assert e_rms_percent <= largest
        if measured is recording:
            assert e_rms_percent == pytest.approx(result.e_rms_percent, rel=1e-3)


@pytest.fixture(scope="module")
def tracked(whole_suite, model, tmp_path_factory):
    """Result of the same reference in every mode."""
    directory = tmp_path_factory.mktemp("tracked")
    return {mode: whole_suite.track(harmonic(), model, mode, 0.5, directory)
            for mode in ("open_loop", "feedforward", "composite")}


def test_each_mode_is_better_than_the_one_before(tracked):
    # What the stage creeps after all that was played before, feedforward alone cannot know.
    errors = [result.e_rms_percent for result in tracked.values()]
    assert errors[0] > errors[1] > 2 * errors[2]


@pytest.mark.parametrize(("mode", "largest_e_rms_percent"), [
    ("pid", 15.0), ("pi", 20.0), ("composite_single_rate", 2.0)])
def test_further_modes_track_a_slow_reference(
        suite, model, tmp_path, mode, largest_e_rms_percent):
    result = suite.track(harmonic(10.0), model, mode, 0.3, tmp_path)
    assert result.e_rms_percent <= largest_e_rms_percent
    assert result.missed_feedback == 0


def test_run_is_recorded_with_model_parameters_and_truth_and_without_gaps(tracked, model):
    for mode, result in tracked.items():
        recording = read_recording(result.recording)
        assert recording.complete
        assert recording.gaps == []
        assert recording.attachments["model.json"] == model.read_bytes()
        parameters = json.loads(recording.attachments["parameters.json"])
        assert parameters["mode"] == mode
        assert parameters["reference"]["frequency_hz"] == [100.0]
        assert recording.voltage_v[-1] == 0.0
        truth = read_recording(result.recording, topic="ground_truth")
        assert truth.gaps == []
        assert np.array_equal(truth.sample_index, recording.sample_index)
        assert np.array_equal(truth.voltage_v, recording.voltage_v)


@pytest.fixture(scope="module")
def other_version(model, tmp_path_factory):
    path = tmp_path_factory.mktemp("other") / "model.json"
    path.write_text(json.dumps({**json.loads(model.read_text()), "version": 99}))
    return path


@pytest.mark.parametrize(("fields", "sentence"), [
    ({"model": "/no/model.json"}, "the model '/no/model.json'.*No such file.*identify the stage"),
    ({"model": "other_version"}, "version.* 99"),
    ({"mode": "closed"}, "unknown mode 'closed': use one of open_loop, pid, pi, feedforward, "),
    ({"duration_s": 0.0}, "duration_s is 0: give more than 0"),
    ({"duration_s": math.nan}, "duration_s is nan: give more than 0"),
    ({"reference": harmonic(amplitude_um=math.nan)}, "amplitude_um nan is not a positive number"),
    ({"reference": harmonic(centre_um=math.nan)}, "centre_um of the reference is not a finite"),
    ({"reference": {"kind": "square"}}, "unknown kind of reference 'square'"),
    ({"reference": {"kind": "file", "file": "/no/reference.csv"}}, "/no/reference.csv"),
    ({"reference": harmonic(centre_um=300.0)}, "the amplifier cannot hold the reference's mean"),
])
def test_track_is_refused_in_one_sentence_and_nothing_moves(
        suite, model, other_version, tmp_path, fields, sentence):
    if fields.get("model") == "other_version":
        fields = {"model": other_version}
    before = suite.play([0.0]).last_sample
    with pytest.raises(GoalFailed) as failure:
        suite.goal("track", **goal_fields(**{"model": model, "directory": tmp_path, **fields}))
    message = failure.value.result.message
    assert re.search(sentence, message)
    assert "\n" not in message
    assert "Errno" not in message
    assert list(tmp_path.iterdir()) == []
    assert suite.play([0.0]).first_sample == before + 1


def test_unreachable_amplitude_is_refused_and_the_one_named_instead_is_reached(
        suite, model, tmp_path):
    before = suite.play([0.0]).last_sample
    with pytest.raises(GoalFailed) as failure:
        suite.track(harmonic(1000.0, 80.0), model, "feedforward", 0.1, tmp_path)
    message = failure.value.result.message
    assert "the amplifier cannot follow 80 um peak to peak" in message
    assert suite.play([0.0]).first_sample == before + 1
    reachable_um = float(re.search(r"([\d.]+) um peak to peak is within reach", message)[1])
    assert 10.25 < reachable_um < 80.0
    assert suite.track(
        harmonic(1000.0, reachable_um), model, "feedforward", 0.1, tmp_path).success


@pytest.mark.parametrize("mode", ["open_loop", "pid"])
def test_amplitude_that_no_mode_reaches_is_refused_before_anything_moves(
        suite, model, tmp_path, mode):
    before = suite.play([0.0]).last_sample
    with pytest.raises(GoalFailed, match="um peak to peak is within reach"):
        suite.track(harmonic(3000.0), model, mode, 0.1, tmp_path)
    assert list(tmp_path.iterdir()) == []
    assert suite.play([0.0]).first_sample == before + 1


def test_run_that_did_not_follow_is_recorded_and_says_so(suite, model, tmp_path):
    goal = suite.send_goal("track", **goal_fields(
        model, tmp_path, harmonic(1000.0, 10.0), mode="pid", duration_s=0.1))
    status, result = suite.result(goal)
    assert (status, result.success) == (GoalStatus.STATUS_SUCCEEDED, True)
    assert NOT_FOLLOWED in result.message
    assert result.e_rms_percent > 30.0
    recording = read_recording(result.recording)
    assert recording.complete and recording.voltage_v[-1] == 0.0


def test_second_goal_is_refused_while_one_runs_and_the_first_goes_on(suite, model, tmp_path):
    goal = suite.begin("track", **goal_fields(model, tmp_path, duration_s=GOES_ON_S))
    with pytest.raises(GoalFailed, match=r"rejected the goal: it is busy with controller/track "
                                         rf"for {suite.node.get_fully_qualified_name()} "
                                         r"\("):
        suite.goal("track", **goal_fields(model, tmp_path))
    lines, is_stopped = status_lines(suite)
    told = "\n".join(lines)
    assert not is_stopped
    assert f"controller: busy with controller/track for {suite.node.get_fully_qualified_name()}" \
        in told
    assert "identification: works on no goal" in told
    with pytest.raises(GoalFailed, match="is being recorded: stop it first"):
        suite.run_experiment("dynamics", tmp_path)
    with pytest.raises(GoalFailed,
                       match=r"the stage is busy \(track for /left/controller, .* s left"):
        suite.play([1.0])
    assert suite.blocks[-1].flags & SampleBlock.FLAG_TRACKING
    status, result = suite.cancel(goal)
    assert status == GoalStatus.STATUS_CANCELED, result.message
    assert read_recording(result.recording).gaps == []


def test_cancelled_track_ramps_to_rest_and_its_recording_reads_back(suite, model, tmp_path):
    goal = suite.begin("track", **goal_fields(model, tmp_path, duration_s=GOES_ON_S))
    status, result = suite.cancel(goal)
    assert status == GoalStatus.STATUS_CANCELED
    assert (result.success, result.message) == (False, "cancelled")
    recording = read_recording(result.recording)
    assert recording.complete
    assert recording.gaps == []
    assert recording.voltage_v[-1] == 0.0
    assert recording.tracking.sum() < GOES_ON_S * 40_000


def test_track_cancelled_while_it_is_planned_moves_nothing(suite, model, tmp_path):
    before = suite.play([0.0]).last_sample
    # A file of its own, for which no feedback has been designed yet: that takes a while.
    unknown = tmp_path / "model.json"
    unknown.write_text(model.read_text() + "\n")
    goal = suite.send_goal("track", **goal_fields(unknown, tmp_path, duration_s=GOES_ON_S))
    status, result = suite.cancel(goal)
    assert status == GoalStatus.STATUS_CANCELED
    assert result.message == "cancelled"
    assert list(tmp_path.iterdir()) == [unknown]
    assert suite.play([0.0]).first_sample == before + 1


def test_emergency_stop_ends_a_track_whose_recording_stays_readable(suite, model, tmp_path):
    goal = suite.begin("track", **goal_fields(model, tmp_path, duration_s=GOES_ON_S))
    assert suite.trigger("emergency_stop").success
    status, result = suite.result(goal)
    assert status == GoalStatus.STATUS_ABORTED
    assert result.message == "the stage stopped before the end: emergency stop"
    recording = read_recording(result.recording)
    assert recording.gaps == []
    assert recording.voltage_v[-1] == 0.0
    with pytest.raises(GoalFailed, match="the stage is stopped"):
        suite.goal("track", **goal_fields(model, tmp_path))
    lines, is_stopped = status_lines(suite)
    assert is_stopped and "now: emergency stop" in "\n".join(lines)
    assert suite.trigger("reset").success


@pytest.fixture
def controller(suite):
    """Process of the controller, which the test may end."""
    yield suite.processes.process("controller")
    suite.until(lambda: "controller" not in suite.node_names())
    suite.processes.start("controller", namespace="/left")
    suite.until(lambda: "controller" in suite.node_names())


def test_controller_that_is_ended_stops_the_stage_and_tells_its_client(
        suite, controller, model, tmp_path):
    goal = suite.begin("track", **goal_fields(model, tmp_path, duration_s=GOES_ON_S))
    controller.send_signal(signal.SIGINT)
    status, result = suite.result(goal)
    assert status == GoalStatus.STATUS_ABORTED
    assert result.message == "cancelled: the node /left/controller was ended"
    suite.until(lambda: controller.poll() is not None)
    assert controller.returncode == 0
    recording = read_recording(result.recording)
    assert recording.gaps == []
    assert recording.voltage_v[-1] == 0.0
