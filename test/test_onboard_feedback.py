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
from piezo_controller.feedback.feedback_design import design_feedback
from piezo_controller.feedback.synthesis.weights import load_weights
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import save_model
from piezo_recorder.reading.reader import read_recording

REFERENCE = {"kind": "harmonic", "frequency_hz": [40.0], "amplitude_um": [20.0], "centre_um": 50.0}
LOOPS = ("onboard", "remote")
DURATION_S = 0.3


@pytest.fixture(scope="module")
def files(near_model, tmp_path_factory):
    """Paths of the model, and of a controller for a tick of computing time."""
    directory = tmp_path_factory.mktemp("files")
    save_model(directory / "model.json", IdentifiedModel(near_model, (-20.0, 120.0)))
    save_controller(directory / "answers.json", design_feedback(near_model, load_weights()))
    return directory


def track(nodes, namespace, files, directory, controller):
    client = nodes.start("recorder", "controller", namespace=namespace,
                         node_parameters={"controller": controller})
    directory.mkdir()
    return client.goal("track", reference=Reference(**REFERENCE), model=str(files / "model.json"),
                       mode="composite", duration_s=DURATION_S, directory=str(directory))


@pytest.fixture(scope="module")
def same(nodes, files, tmp_path_factory):
    """Results of one controller, on board and answered."""
    directory = tmp_path_factory.mktemp("same")
    return {loop: track(nodes, f"/{loop}", files, directory / loop, {
        "feedback": loop, "controller_file": str(files / "answers.json"),
        "feedback_place": "behind_inverse"}) for loop in LOOPS}


def test_law_on_board_plays_what_answers_play(same):
    onboard, remote = (read_recording(same[loop].recording) for loop in LOOPS)
    assert same["onboard"].e_rms_percent == pytest.approx(
        same["remote"].e_rms_percent, abs=1e-9)
    for name in ("voltage_v", "displacement_um"):
        np.testing.assert_allclose(getattr(onboard, name), getattr(remote, name), atol=1e-9)
    assert np.array_equal(onboard.flags, remote.flags)


def messages(result, topic):
    with AnyReader([Path(result.recording)]) as reader:
        return [reader.deserialize(data, connection.msgtype)
                for connection, _, data in reader.messages()
                if connection.topic.endswith(topic)]


def test_feedback_and_its_flags_are_recorded_tick_by_tick(same):
    applied_v = np.concatenate([
        message.voltage_v for message in messages(same["onboard"], "/applied_feedback")])
    answers = {message.tick: message.voltage_v
               for message in messages(same["remote"], "/feedback")}
    blocks = [message for message in messages(same["onboard"], "/samples")
              if message.flags & SampleBlock.FLAG_TRACKING]
    first_tick = blocks[0].first_sample // 40
    expected_v = [answers.get(tick - 1, 0.0) for tick in
                  range(first_tick, first_tick + len(applied_v))]
    assert np.abs(applied_v).max() > 0.1
    np.testing.assert_allclose(applied_v, expected_v, atol=1e-9)
    # Twenty ticks to a message.
    assert len(blocks) < len(applied_v) / 10


def test_law_designed_without_computing_time_leaves_less_and_ends_with_its_client(
        same, nodes, files, tmp_path):
    client = nodes.start("recorder", "controller", namespace="/quick",
                         node_parameters={"controller": {"feedback": "onboard"}})
    fields = {"reference": Reference(**REFERENCE), "model": str(files / "model.json"),
              "mode": "composite", "directory": str(tmp_path)}
    quick = client.goal("track", duration_s=DURATION_S, **fields)
    assert quick.e_rms_percent < 0.95 * same["remote"].e_rms_percent
    client.forget()
    client.begin("track", duration_s=3000.0, **fields)
    client.until(lambda: client.blocks[-1].flags & SampleBlock.FLAG_TRACKING)
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
