# SPDX-License-Identifier: BSD-3-Clause
"""A feedback that the stage evaluates by itself, beside the same feedback answered by messages."""

import signal
from pathlib import Path

import numpy as np
import pytest
from piezo_interfaces.msg import FeedbackLaw, Reference, SampleBlock, StateSpace
from piezo_interfaces.srv import LoadFeedback, StartTracking
from rosbags.highlevel import AnyReader

from piezo_controller.feedback.controller_file import save_controller
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import save_model
from piezo_recorder.reading.reader import read_recording

REFERENCE = {"kind": "harmonic", "frequency_hz": [40.0], "amplitude_um": [20.0], "centre_um": 50.0}
LOOPS = ("onboard", "remote")
DURATION_S = 0.15
TICK = 40
MOST_RUNS = 50


@pytest.fixture(scope="module")
def files(near_model, near_controller, tmp_path_factory):
    """Paths of the model, and of a controller for a tick of computing time."""
    directory = tmp_path_factory.mktemp("files")
    save_model(directory / "model.json", IdentifiedModel(near_model, (-20.0, 120.0)))
    save_controller(directory / "answers.json", near_controller)
    return directory


class Loop:
    """The nodes of a stage, whose controller answers by messages or uploads its feedback."""

    def __init__(self, nodes, namespace, files, directory, controller):
        self.client = nodes.start("recorder", "controller", namespace=namespace,
                                  node_parameters={"controller": controller})
        self._model, self._directory = str(files / "model.json"), directory
        self._runs = 0

    def track(self, mode="composite"):
        return self.client.goal("track", **self.fields(DURATION_S, mode))

    def fields(self, duration_s, mode="composite"):
        self._runs += 1
        directory = self._directory / str(self._runs)
        directory.mkdir()
        return {"reference": Reference(**REFERENCE), "model": self._model, "mode": mode,
                "duration_s": duration_s, "directory": str(directory)}


@pytest.fixture(scope="module")
def loops(nodes, files, tmp_path_factory):
    """Both ways to run one controller."""
    return {loop: Loop(nodes, f"/{loop}", files, tmp_path_factory.mktemp(loop), {
        "feedback": loop, "controller_file": str(files / "answers.json"),
        "feedback_place": "behind_inverse"}) for loop in LOOPS}


@pytest.fixture(scope="module")
def same(loops):
    """Results of the first run of each, which begins anew however long the connecting took."""
    for loop in loops.values():
        loop.client.restart()
    return {name: loop.track() for name, loop in loops.items()}


def test_law_on_board_plays_what_answers_play(same):
    onboard, remote = (read_recording(same[loop].recording) for loop in LOOPS)
    assert same["onboard"].e_rms_percent == pytest.approx(
        same["remote"].e_rms_percent, abs=1e-9)
    for name in ("voltage_v", "displacement_um"):
        np.testing.assert_allclose(getattr(onboard, name), getattr(remote, name), atol=1e-9)
    assert np.array_equal(onboard.flags, remote.flags)


@pytest.mark.parametrize("loop", LOOPS)
def test_reference_is_recorded_beside_the_samples(same, loop):
    recording = read_recording(same[loop].recording)
    assert recording.reference_um.size == recording.sample_index.size
    followed = np.isfinite(recording.reference_um)
    assert np.array_equal(followed, recording.tracking)
    count = round(DURATION_S * 40_000)
    turn = 2 * np.pi * REFERENCE["frequency_hz"][0] * np.arange(count) / 40_000
    np.testing.assert_allclose(
        recording.reference_um[followed][-count:],
        REFERENCE["centre_um"] + REFERENCE["amplitude_um"][0] / 2 * np.sin(turn), atol=1e-9)


def messages(result, topic):
    with AnyReader([Path(result.recording)]) as reader:
        return [reader.deserialize(data, connection.msgtype)
                for connection, _, data in reader.messages()
                if connection.topic.endswith(topic)]


def test_what_the_law_adds_is_recorded_tick_by_tick(loops, same):
    loop = loops["onboard"]
    # Until the recorder has met the publisher, which each run could be too short for, and lost
    # nothing on a busy computer.
    for _ in range(MOST_RUNS):
        result = loop.track()
        applied = messages(result, "/applied_feedback")
        ticks = sum(len(message.voltage_v) for message in applied)
        if ticks * TICK == tracked(result).sample_index.size:
            break
    planned = tracked(loop.track("feedforward"))
    applied_v = np.concatenate([message.voltage_v for message in applied])
    assert np.abs(applied_v).max() > 0.1
    # The same is planned each time.
    added_v = tracked(result).voltage_v - planned.voltage_v
    np.testing.assert_allclose(np.repeat(applied_v, TICK), added_v, atol=1e-9)
    blocks = [message for message in messages(result, "/samples")
              if message.flags & SampleBlock.FLAG_TRACKING]
    assert len(blocks) == len(applied) < len(applied_v) / 10


def tracked(result):
    """Return the part of a recording in which the feedforward plays."""
    recording = read_recording(result.recording)
    return recording.select(recording.has(SampleBlock.FLAG_TRACKING))


@pytest.mark.long
def test_law_designed_without_computing_time_leaves_less_and_ends_with_its_client(
        same, nodes, files, tmp_path):
    loop = Loop(nodes, "/quick", files, tmp_path, {})
    client = loop.client
    assert loop.track().e_rms_percent < 0.95 * same["remote"].e_rms_percent
    client.forget()
    client.begin("track", **loop.fields(3000.0))
    client.until_flagged(SampleBlock.FLAG_TRACKING)
    client.processes.process("controller").send_signal(signal.SIGKILL)
    client.until(lambda: client.blocks[-1].flags & SampleBlock.FLAG_STOPPED)
    assert client.samples().voltage_v[-1] == 0.0
    assert "the client /quick/controller is gone" in client.logs()


def test_law_that_is_not_stable_or_does_not_fit_is_refused_over_the_service(nodes):
    stage = nodes.start(namespace="/refusing")
    law = FeedbackLaw(
        tick=StateSpace(a=[1.0], b=[1.0], c=[1.0], d=1.0), observer=[0.5], max_feedback_v=20.0,
        once_expected_um=[0.0], model=StateSpace(a=[0.9], b=[0.1], c=[1.0]),
        model_gains_um_per_v=[100.0])
    response = stage.call(LoadFeedback, "load_feedback", law=law)
    assert not response.success
    assert "load_feedback refused: the feedback law is not stable" in response.message
    law.model_gains_um_per_v, law.observer = [0.3], []
    response = stage.call(LoadFeedback, "load_feedback", law=law)
    assert "observer has 0 elements for 1 states" in response.message
    law.observer = [0.5]
    assert stage.load([0.0]).success
    response = stage.call(StartTracking, "start_tracking", onboard=True, ticks=3)
    assert "no feedback law is loaded for this feedforward" in response.message
    assert stage.call(LoadFeedback, "load_feedback", law=law).success
    assert stage.call(StartTracking, "start_tracking", onboard=True, ticks=3).success
    assert stage.samples().voltage_v[-1] == 0.0
