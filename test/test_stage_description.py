# SPDX-License-Identifier: BSD-3-Clause
"""The stage tells its limits and its clock, and the other nodes take them from it."""

import json
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from lifecycle_msgs.msg import Transition
from piezo_interfaces.msg import Reference, StageDescription
from piezo_interfaces.srv import StartRecording
from rosbags.highlevel import AnyReader

from piezo_client.client import Client, GoalFailed
from piezo_client.stage import Stage
from piezo_identification import StageLimits
from piezo_identification.experiments.catalogue import named_experiment
from piezo_models.model_file import IdentifiedModel, save_model
from piezo_recorder.reading.reader import read_recording
from piezo_ros.quality import DESCRIPTION
from piezo_ros.requests.calls import CallFailed
from piezo_ros.stage_runs.described_stage import DescribedStage

LIMITS = {"sample_rate_hz": 20_000.0, "samples_per_tick": 20, "minimum_voltage_v": -5.0,
          "maximum_voltage_v": 60.0, "rest_voltage_v": 1.0, "slew_limit_v_per_s": 1.5e6,
          "ramp_rate_v_per_s": 1800.0, "max_feedback_v": 33.0, "max_feedback_step_v": 11.0,
          "minimum_displacement_um": -44.0, "maximum_displacement_um": 99.0}

NARROW = {"maximum_voltage_v": 60.0, "sample_rate_hz": 20_000.0, "samples_per_tick": 20}


class Listener:
    """Hears what is said of a stage from now on, and how many say it."""

    def __init__(self, client):
        self._client = client
        self.heard = []
        self._subscription = client.node.create_subscription(
            StageDescription, "stage/description", self.heard.append, DESCRIPTION)

    def until_heard(self, count=1):
        self._client.until(lambda: len(self.heard) >= count)
        return self.heard[-1]

    def until_silent(self):
        self._client.until(lambda: self._subscription.get_publisher_count() == 0)


def refusal(client, name, **fields):
    with pytest.raises(GoalFailed) as failure:
        client.goal(name, **fields)
    return str(failure.value)


@pytest.fixture(scope="module")
def model_file(plain_model, tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "model.json"
    save_model(path, IdentifiedModel(plain_model, (-20.0, 120.0)))
    return str(path)


def track(model_file, directory, amplitude_um=10.0):
    return {"reference": Reference(kind="harmonic", frequency_hz=[100.0], centre_um=20.0,
                                   amplitude_um=[amplitude_um]),
            "model": model_file, "mode": "feedforward", "duration_s": 0.05,
            "directory": str(directory)}


def test_description_is_told_from_configure_to_cleanup_to_whoever_asks_whenever(nodes):
    stage = nodes.start(namespace="/described", connect=False, autostart=False, **LIMITS)
    early = Listener(stage)
    assert stage.state() == "unconfigured"
    assert early.heard == []
    for count, transition in enumerate((Transition.TRANSITION_CONFIGURE,) * 2, 1):
        assert stage.change_state(transition)
        told = early.until_heard(count)
        assert Listener(stage).until_heard() == told
        assert stage.change_state(Transition.TRANSITION_CLEANUP)
        early.until_silent()
    assert {name: getattr(told, name) for name in LIMITS} == LIMITS
    assert (told.backend, told.timing, told.lead_ticks) == ("simulated", "lockstep", 0)

    assert stage.change_state(Transition.TRANSITION_CONFIGURE)
    assert stage.change_state(Transition.TRANSITION_ACTIVATE)
    with Stage("/described") as driver:
        stage.beside(driver.settle, rest_s=1)
    stage.until(lambda: any(min(block.voltage_v) == -5.0 for block in stage.blocks))
    stage.until(lambda: stage.blocks[-1].voltage_v[-1] == LIMITS["rest_voltage_v"])


@pytest.fixture(scope="module")
def stage(nodes):
    """The nodes of a stage, which the tests below end, start anew and configure, in this order."""
    return nodes.start("recorder", "identification", "controller", namespace="/replaced")


def goals(model_file, directory):
    return [("run_experiment", {"experiment": "dynamics", "directory": str(directory)}),
            ("track", track(model_file, directory))]


def test_goal_is_refused_where_nobody_serves_the_stage_any_more(stage, model_file, tmp_path):
    # What 120 V reach, and 60 V do not.
    assert stage.goal("track", **track(model_file, tmp_path / "wide", 45.0)).success
    stage.processes.stop(["stage"])
    stage.until(lambda: "stage" not in stage.node_names())
    asked = goals(model_file, tmp_path / "none")
    with ThreadPoolExecutor() as threads, Client("/replaced", "second") as second:
        refusals = threads.map(lambda client, goal: refusal(client, goal[0], **goal[1]),
                               (stage, second), asked)
        assert list(refusals) == [
            f"{name}: nobody serves the stage on /replaced/stage/description: start its node"
            for name, _ in asked]
    assert not (tmp_path / "none").exists()


def test_goal_is_refused_while_the_stage_is_not_configured(stage, model_file, tmp_path):
    stage.processes.start("stage", {"timing": "lockstep", **NARROW}, "/replaced")
    stage.until(lambda: "stage" in stage.node_names())
    for name, fields in goals(model_file, tmp_path):
        assert refusal(stage, name, **fields) == (
            f"{name}: the stage is unconfigured: configure and activate it first")
    assert list(tmp_path.iterdir()) == []


def test_goals_are_made_for_the_limits_and_the_clock_of_the_new_stage(
        stage, model_file, tmp_path):
    listener = Listener(stage)
    assert stage.change_state(Transition.TRANSITION_CONFIGURE)
    told = listener.until_heard()
    assert stage.change_state(Transition.TRANSITION_ACTIVATE)
    experiment = stage.goal("run_experiment", experiment="dynamics", directory=str(tmp_path))
    recording = read_recording(experiment.recording)
    assert recording.sample_rate_hz == 20_000.0
    assert json.loads(recording.attachments["parameters.json"])["maximum_voltage_v"] == 60.0
    expected = named_experiment("dynamics", StageLimits(-20.0, 60.0, sample_rate_hz=20_000.0))
    assert recording.voltage_v.max() == expected.voltage_v.max()
    told_reach = refusal(stage, "track", **track(model_file, tmp_path / "wide", 45.0))
    assert "the stage reaches about" in told_reach

    with AnyReader([tmp_path / "dynamics"]) as reader:
        (connection, _, data), = reader.messages(
            [c for c in reader.connections if c.topic == "/replaced/stage/description"])
        recorded = reader.deserialize(data, connection.msgtype)
    for name in StageDescription.get_fields_and_field_types():
        assert getattr(recorded, name) == getattr(told, name)


def test_parameter_that_contradicts_the_stage_is_refused_with_both_values(
        nodes, model_file, tmp_path):
    stage = nodes.start(
        "identification", "controller", namespace="/contradicted", node_parameters={
            "identification": {"maximum_voltage_v": 100.0, "rest_voltage_v": 0.0},
            "controller": {"samples_per_tick": 20}})
    stage.processes.start("recorder", {"sample_rate_hz": 48_000.0}, "/contradicted")
    stage.until(lambda: "recorder" in stage.node_names())
    assert refusal(stage, "run_experiment", experiment="dynamics", directory=str(tmp_path)) == (
        "run_experiment: parameter maximum_voltage_v is 100.0, but /contradicted/stage/description "
        "publishes 120.0: set it at the stage alone")
    assert refusal(stage, "track", **track(model_file, tmp_path)) == (
        "track: parameter samples_per_tick is 20, but /contradicted/stage/description "
        "publishes 40: set it at the stage alone")
    recording = stage.call(StartRecording, "recorder/start_recording", name="run",
                           directory=str(tmp_path))
    assert recording.message == (
        "parameter sample_rate_hz is 48000.0, but /contradicted/stage/description "
        "publishes 40000.0: set it at the stage alone")
    assert "is 48000.0" in stage.processes.log("recorder").read_text()
    assert list(tmp_path.iterdir()) == []


def test_python_client_plays_at_the_clock_of_the_stage(stage, tmp_path):
    with Stage("/replaced") as driver:
        played = stage.beside(driver.play, [0.0, 0.05, 0.0], directory=tmp_path)
    assert np.isin(0.05, read_recording(played.path).voltage_v)


def test_goal_keeps_the_stage_it_was_planned_for_and_is_not_played_on_another(domain):
    with Client("/planned") as client:
        node = client.node
        stage = DescribedStage(node)

        def serve(**fields):
            publisher = node.create_publisher(StageDescription, "stage/description", DESCRIPTION)
            publisher.publish(StageDescription(**fields))
            return publisher

        def until(condition):
            assert client.spin_until(condition, 300.0)

        first = serve(maximum_voltage_v=120.0)
        until(lambda: stage.description is not None)
        planned = stage.wait(lambda: None)
        stage.check_unchanged(planned)
        node.destroy_publisher(first)
        until(lambda: stage.description is None)
        with pytest.raises(CallFailed, match="stage/description described is gone"):
            stage.check_unchanged(planned)

        second = serve(maximum_voltage_v=60.0)
        until(lambda: stage.description is not None)
        assert planned.maximum_voltage_v == 120.0
        with pytest.raises(CallFailed, match=r"with maximum_voltage_v from 120\.0 to 60\.0"):
            stage.check_unchanged(planned)
        node.destroy_publisher(second)
        until(lambda: stage.description is None)
        serve(maximum_voltage_v=120.0)
        until(lambda: stage.description is not None)
        stage.check_unchanged(planned)
