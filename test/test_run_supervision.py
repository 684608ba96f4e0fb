# SPDX-License-Identifier: BSD-3-Clause
"""A run that did not do what it was asked to says why; nobody else ends or changes it."""

import re
import resource
import signal
import time
from pathlib import Path

import pytest
import yaml
from action_msgs.msg import GoalStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from mcap.reader import make_reader
from piezo_interfaces.msg import Reference
from piezo_interfaces.srv import StartRecording, StopRecording
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

from piezo_client.client import GoalFailed
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import save_model
from piezo_recorder.reading.reader import read_recording
from piezo_ros.stage_runs.run_account import MAX_LATE_PERCENT

TICK_S = 5e-3
# Of the stage's time, whose recording takes more than MOST_BYTES.
RUNS_TO_ITS_END_S = 8.0
MOST_BYTES = 700_000
# Longer than any test asks while it lasts; the test ends it.
GOES_ON_S = 3600.0
NO_DISK_HOLDS_THAT_MB = 1_000_000_000


@pytest.fixture(scope="module")
def model_file(plain_model, tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "model.json"
    save_model(path, IdentifiedModel(plain_model, (-20.0, 120.0)))
    return path


@pytest.fixture
def fields(model_file, tmp_path):
    """Of a goal of track that goes on for a while."""
    return {"reference": Reference(kind="harmonic", frequency_hz=[10.0], amplitude_um=[10.0],
                                   centre_um=30.0),
            "model": str(model_file), "mode": "pi", "duration_s": 2.0,
            "directory": str(tmp_path)}


def set_parameter(suite, node, name, value):
    parameter = Parameter(name, value=value).to_parameter_msg()
    return suite.call(SetParameters, f"{node}/set_parameters", parameters=[parameter]).results[0]


@pytest.fixture
def disk_that_is_filled(suite):
    """Makes the recorder close its recording because the disk is full."""
    yield lambda: set_parameter(suite, "recorder", "minimum_free_mb", NO_DISK_HOLDS_THAT_MB)
    assert set_parameter(suite, "recorder", "minimum_free_mb", 1).successful


@pytest.fixture
def disk_that_holds_little(suite):
    """Let the recorder write no more than some bytes, which says when in a run it ends."""
    recorder = suite.processes.process("recorder").pid
    unlimited = resource.prlimit(recorder, resource.RLIMIT_FSIZE, (MOST_BYTES, -1))
    yield
    resource.prlimit(recorder, resource.RLIMIT_FSIZE, unlimited)


def test_run_whose_recording_ends_stops_and_says_why(suite, fields, disk_that_is_filled):
    fields["duration_s"] = GOES_ON_S
    goal = suite.begin("track", **fields)
    disk_that_is_filled()
    status, result = suite.result(goal)
    assert status == GoalStatus.STATUS_ABORTED
    assert "was closed early: only" in result.message
    assert suite.samples().voltage_v[-1] == 0.0
    assert read_recording(result.recording).complete


def test_run_that_may_go_on_unrecorded_does_and_says_so(suite, fields, disk_that_holds_little):
    fields["duration_s"] = RUNS_TO_ITS_END_S
    goal = suite.send_goal("track", **fields, unrecorded=True)
    status, result = suite.result(goal)
    assert status == GoalStatus.STATUS_SUCCEEDED, result.message
    assert "the run went on unrecorded: " in result.message
    assert "was closed early: File too large" in result.message
    recorded, played = (len(voltage_v) for voltage_v in (
        read_recording(result.recording).voltage_v, suite.samples().voltage_v))
    assert 0 < recorded < played / 2


@pytest.mark.parametrize(("service", "cause"), [
    ("emergency_stop", "the stage stopped before the end: emergency stop"),
    ("stop_tracking", "the stage stopped before the end: somebody else called stop_tracking"),
])
def test_result_holds_the_cause_of_a_stop(suite, fields, service, cause):
    goal = suite.begin("track", **{**fields, "duration_s": GOES_ON_S})
    assert suite.trigger(service).success
    status, result = suite.result(goal)
    assert status == GoalStatus.STATUS_ABORTED
    assert result.message == cause
    suite.until(lambda: suite.trigger("reset").success)


def test_stranger_does_not_stop_the_recording_of_a_run(suite, fields):
    fields["duration_s"] = GOES_ON_S
    goal = suite.begin("track", **fields)
    for stranger in "", "/left/somebody":
        refused = suite.call(StopRecording, "recorder/stop_recording", client=stranger)
        assert not refused.success
        assert "is recorded for /left/controller: only that node stops it" in refused.message
    status, result = suite.cancel(goal)
    assert status == GoalStatus.STATUS_CANCELED, result.message
    assert read_recording(result.recording).gaps == []


def test_recording_that_names_no_client_is_stopped_by_anybody(suite, tmp_path):
    assert suite.call(StartRecording, "recorder/start_recording", directory=str(tmp_path),
                      name="free").success
    last_sample = suite.play([0.0]).last_sample
    assert suite.call(StopRecording, "recorder/stop_recording", last_sample=last_sample,
                      client="/left/somebody").success


def test_clock_of_a_node_is_not_changed_while_it_matters(suite, fields):
    fields["duration_s"] = GOES_ON_S
    goal = suite.begin("track", **fields)
    for node, reason in [("stage", "the stage is active"), ("controller", "a goal runs"),
                         ("recorder", "a recording runs")]:
        refused = set_parameter(suite, node, "use_sim_time", True)
        assert not refused.successful
        assert refused.reason == (f"use_sim_time cannot be changed while {reason}: "
                                  "wait for its end, or end it first")
        assert set_parameter(suite, node, "use_sim_time", False).successful  # as it is
    status, result = suite.cancel(goal)
    assert status == GoalStatus.STATUS_CANCELED, result.message
    for value in True, False:
        assert set_parameter(suite, "controller", "use_sim_time", value).successful


def test_node_that_is_not_active_rejects_goals(suite, tmp_path):
    def change(transition):
        return suite.call(ChangeState, "identification/change_state",
                          transition=Transition(id=transition)).success

    assert change(Transition.TRANSITION_DEACTIVATE)
    with pytest.raises(GoalFailed, match="rejected the goal"):
        suite.run_experiment("dynamics", tmp_path)
    assert "goal rejected: identification is not active: activate it first" in suite.logs()
    assert change(Transition.TRANSITION_ACTIVATE)
    assert suite.run_experiment("dynamics", tmp_path).success


def test_node_that_is_deactivated_cancels_its_goal_and_says_so(suite, fields):
    goal = suite.begin("track", **{**fields, "duration_s": GOES_ON_S})
    for transition in Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_ACTIVATE:
        assert suite.call(ChangeState, "controller/change_state",
                          transition=Transition(id=transition)).success
        if transition == Transition.TRANSITION_DEACTIVATE:
            status, result = suite.result(goal)
    assert status == GoalStatus.STATUS_ABORTED
    assert result.message == "cancelled: the node /left/controller was deactivated"


def test_recording_bears_the_quality_of_its_topics(suite, fields):
    path = suite.goal("track", **fields).recording
    with open(f"{path}/metadata.yaml", encoding="utf-8") as stream:
        metadata = yaml.safe_load(stream)["rosbag2_bagfile_information"]
    offered = {topic["topic_metadata"]["name"]: topic["topic_metadata"]["offered_qos_profiles"]
               for topic in metadata["topics_with_message_count"]}
    for topic in "samples", "feedback", "ground_truth":
        profiles = offered[f"/left/{topic}"]
        assert profiles
        assert {(profile["reliability"], profile["durability"]) for profile in profiles} == {
            ("reliable", "volatile")}
    with open(next(Path(path).glob("*.mcap")), "rb") as stream:
        channels = make_reader(stream).get_summary().channels.values()
    assert {channel.topic: yaml.safe_load(channel.metadata["offered_qos_profiles"])
            for channel in channels} == offered


@pytest.fixture(scope="module")
def paced(nodes):
    """A paced stage whose controller answers block by block."""
    return nodes.start("recorder", "controller", namespace="/late", timing="paced",
                       samples_per_tick=round(TICK_S * 40_000), max_missed_feedback=10_000,
                       node_parameters={"controller": {"feedback": "remote"}})


def test_run_whose_answers_came_late_fails_and_says_how_many(paced, fields):
    stage = paced
    goal = stage.begin("track", **fields)
    controller = stage.processes.process("controller")
    late = 2 * MAX_LATE_PERCENT / 100.0 * fields["duration_s"] / TICK_S
    # Again and again, as a busy process learns too late that the run goes on; each time for far
    # less long than others wait for a sign of life. The run may end undisturbed.
    for _ in range(10):
        if stage.spin_until(goal.outcome.done, 3.0 * late * TICK_S):
            break
        controller.send_signal(signal.SIGSTOP)
        time.sleep(3.0 * late * TICK_S)
        controller.send_signal(signal.SIGCONT)
    status, result = stage.result(goal)
    assert status == GoalStatus.STATUS_ABORTED
    assert re.search(r"^\d+ of \d+ answers were late, more than max_late_percent, 1: ",
                     result.message)
    assert result.missed_feedback > late
    assert result.e_rms_percent > 0.0
    assert read_recording(result.recording).complete


def test_computer_that_is_too_slow_for_a_stage_is_told_before_anything_moves(paced, fields):
    paced.processes.stop(["stage"])
    paced.until(lambda: "stage" not in paced.node_names())
    # No computer misses no answer at all; with longer ticks less is published meanwhile.
    paced.processes.start("stage", {
        "timing": "paced", "autostart": True, "max_missed_feedback": 0,
        "samples_per_tick": round(TICK_S * 40_000)}, "/late")
    paced.until(lambda: "stage" in paced.node_names())
    paced.forget()
    status, result = paced.result(paced.send_goal("track", **fields))
    assert status == GoalStatus.STATUS_ABORTED
    assert "this computer is too busy to answer every 5 ms" in result.message
    assert result.recording == ""
    assert not any(any(block.voltage_v) for block in paced.blocks)
