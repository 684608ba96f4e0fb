# SPDX-License-Identifier: BSD-3-Clause
"""The recorder as a process of its own, fed by a publisher that stands in for the recorder."""

import array
import hashlib
import os
import re
import signal

import numpy as np
import pytest
import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from forked_processes import ForkedProcesses
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from piezo_interfaces.msg import FeedbackVoltage, SampleBlock, StageDescription
from piezo_interfaces.srv import StartRecording, StopRecording
from rcl_interfaces.srv import SetParameters
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from rosbags.highlevel import AnyReader

from piezo_bringup.processes import Processes
from piezo_client.client import Client
from piezo_recorder.reading.reader import read_recording
from piezo_ros.quality import DESCRIPTION, SAMPLES

TIMEOUT_S = 300.0
NAMESPACE = "/recorded"
SAMPLE_RATE_HZ = 40_000.0


class FedRecorder(Client):
    """Publish sample blocks, and call the recorder's services."""

    def __init__(self, processes):
        super().__init__(NAMESPACE)
        self.process = processes.process("recorder")
        self._log = processes.log("recorder")
        self._samples, self._ground_truth = (
            self.node.create_publisher(SampleBlock, topic, SAMPLES)
            for topic in ("samples", "ground_truth"))
        self._feedback = self.node.create_publisher(FeedbackVoltage, "feedback", SAMPLES)
        self._description = self.node.create_publisher(
            StageDescription, "stage/description", DESCRIPTION)
        self._description.publish(StageDescription(sample_rate_hz=SAMPLE_RATE_HZ))
        self._start = self.node.create_client(StartRecording, "recorder/start_recording")
        self._name = self.node.get_fully_qualified_name()
        self.diagnostics = []
        self.node.create_subscription(
            DiagnosticArray, "/diagnostics",
            lambda message: self.diagnostics.extend(  # not those of other nodes in this domain
                status for status in message.status
                if status.name.startswith(f"{NAMESPACE}/recorder:")), 10)
        self.until(lambda: all(publisher.get_subscription_count() for publisher in (
            self._samples, self._ground_truth, self._feedback)))

    def start(self, directory, name, **fields):
        self.until(self._start.service_is_ready)
        return self._answer(self._start, "recorder/start_recording", StartRecording.Request(
            **{"directory": str(directory), "name": name, "client": self._name, **fields}))

    def stop(self, last_sample=0):
        return self.call(StopRecording, "recorder/stop_recording", last_sample=last_sample,
                         client=self._name)

    def until(self, condition):
        if not self.spin_until(condition, TIMEOUT_S):
            pytest.fail(f"nothing came for {TIMEOUT_S:g} s; the recorder says:\n"
                        + self._log.read_text()
                        + f"and told {len(self.diagnostics)} times, at last "
                        f"{self.diagnostics[-1:]}")

    def publish(self, ticks):
        for tick in ticks:
            block = SampleBlock(
                first_sample=40 * tick, sample_period_s=2.5e-5, tick=tick + 1, flags=32,
                voltage_v=array.array("d", np.full(40, tick)),
                displacement_um=array.array("d", np.arange(40.0) + tick))
            self._samples.publish(block)
            block.displacement_um = array.array("d", np.arange(40.0) - tick)
            self._ground_truth.publish(block)
            self._feedback.publish(FeedbackVoltage(tick=tick + 1, voltage_v=float(tick)))
        for publisher in (self._samples, self._ground_truth, self._feedback):
            publisher.wait_for_all_acked(Duration(seconds=TIMEOUT_S))


@pytest.fixture
def kind():
    return ForkedProcesses


@pytest.fixture
def recorder(tmp_path, kind):
    with kind(tmp_path / "logs", data_root=tmp_path) as processes:
        processes.start("recorder", namespace=NAMESPACE)
        with FedRecorder(processes) as recorder:
            yield recorder


def test_every_message_is_recorded_and_numbers_are_told(recorder, tmp_path):
    assert not recorder.stop().success
    started = recorder.start(
        tmp_path, "run", attachment_names=["model.json"], attachment_contents=["{}"])
    assert started.success, started.message
    recorder.publish(range(500))
    stopped = recorder.stop(last_sample=40 * 500 - 1)
    assert stopped.success, stopped.message
    assert (stopped.samples, stopped.missing_samples) == (20_000, 0)
    assert stopped.path == started.path == str(tmp_path / "run")

    recording = read_recording(stopped.path)
    assert np.array_equal(recording.sample_index, np.arange(20_000))
    assert np.array_equal(recording.voltage_v, np.repeat(np.arange(500), 40))
    assert recording.tracking.all()
    assert recording.attachments == {"model.json": b"{}"}
    truth = read_recording(stopped.path, topic="ground_truth")
    assert truth.displacement_um[-40:].tolist() == list(range(-499, -459))
    with AnyReader([tmp_path / "run"]) as reader:
        counts = {topic: info.msgcount for topic, info in reader.topics.items()}
    assert counts == {
        **{f"{NAMESPACE}/{topic}": 500 for topic in ("samples", "ground_truth", "feedback")},
        f"{NAMESPACE}/applied_feedback": 0, f"{NAMESPACE}/reference": 0,
        f"{NAMESPACE}/controller/reference": 0, f"{NAMESPACE}/marks": 0,
        f"{NAMESPACE}/stage/description": 1}

    refused = recorder.start(tmp_path, "run")
    assert not refused.success
    assert "exists already" in refused.message


def test_attachment_may_come_as_path_and_hash_of_a_file(recorder, tmp_path):
    content, file = b'{"level_count": 50}', tmp_path / "mine.json"
    file.write_bytes(content)
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("/dev/zero")
    of_the_file = {"attachment_names": ["model.json"], "attachment_contents": [""],
                   "attachment_sha256": [hashlib.sha256(content).hexdigest()]}
    other = hashlib.sha256(b"other").hexdigest()
    for fields, reason in (
            ({"attachment_sha256": [other]}, "another sha256"),
            ({"attachment_paths": ["/dev/zero"]}, "is outside"),
            ({"attachment_paths": [str(tmp_path / "link")]}, "is outside"),
            ({"attachment_paths": [str(tmp_path / "pipe")]}, "is a pipe"),
            ({"attachment_paths": [str(tmp_path)]}, "is a directory"),
            ({"attachment_paths": [str(tmp_path / "none")]}, "No such file")):
        refused = recorder.start(tmp_path, "run", **{
            **of_the_file, "attachment_paths": [str(file)], **fields})
        assert (refused.success, refused.unread_attachments) == (False, ["model.json"])
        assert re.search(reason, refused.message)
    assert not (tmp_path / "run").exists()
    started = recorder.start(tmp_path, "run", **of_the_file, attachment_paths=[str(file)])
    assert started.success, started.message
    file.unlink()
    recorder.publish(range(3))
    assert recorder.stop(119).success
    assert read_recording(started.path).attachments == {"model.json": content}


def test_start_that_was_given_up_begins_nothing(recorder, tmp_path):
    refused = recorder.start(tmp_path, "run", deadline=Time(sec=1))
    assert not refused.success
    assert "gave this request up" in refused.message
    assert not (tmp_path / "run").exists()


def test_who_did_not_hear_the_answer_asks_again_and_gets_the_same(recorder, tmp_path):
    started = recorder.start(tmp_path, "run")
    assert started.success, started.message
    assert recorder.start(tmp_path, "run") == started
    # Others than who began it, and another recording, are refused.
    for name, fields in (("run", {"client": ""}), ("run", {"client": "/other"}), ("other", {})):
        assert "is being recorded" in recorder.start(tmp_path, name, **fields).message
    recorder.publish(range(3))
    stopped = recorder.stop(119)
    assert (stopped.success, stopped.samples) == (True, 120)
    assert recorder.stop(119) == stopped
    assert "Nothing is being recorded" in recorder.stop(79).message
    # From the next start on, the recording before is forgotten, whatever became of that.
    assert "exists already" in recorder.start(tmp_path, "run").message
    assert "Nothing is being recorded" in recorder.stop(119).message


def test_what_is_not_under_the_data_root_is_refused_in_one_line(recorder, tmp_path):
    outside = tmp_path.parent / f"{tmp_path.name}_outside"
    outside.mkdir()
    (tmp_path / "link").symlink_to(outside)
    for directory in ("..", outside, "link", "link/new", "/", f"../{outside.name}"):
        refused = recorder.start(directory, "run")
        assert not refused.success
        assert f"'{directory}' is outside {tmp_path}" in refused.message
        assert "data_root" in refused.message
    for directory, name, attachment in (
            ("", "../run", "a"), ("", "two\nlines", "a"), ("", ".run", "a"), ("", "x" * 300, "a"),
            ("", "run", "../../x"), ("", "run", "a\nb"), ("x" * 300, "run", "a"),
            ("x/" * 3000, "run", "a"), ("a\nb", "run", "a")):
        refused = recorder.start(
            directory, name, attachment_names=[attachment], attachment_contents=[""])
        assert not refused.success
        assert refused.message.isprintable()
        assert ": give a" in refused.message
    assert not [*outside.iterdir()]
    assert {path.name for path in tmp_path.iterdir()} == {"logs", "link"}
    log = (tmp_path / "logs" / "recorder.log").read_text()
    assert "Traceback" not in log

    started = recorder.start("new/folder", "run")  # taken from the root, not from here
    assert started.path == str(tmp_path / "new" / "folder" / "run")
    assert recorder.stop().success


def test_a_gap_is_counted(recorder, tmp_path):
    assert recorder.start(tmp_path, "run").success
    assert "is being recorded" in recorder.start(tmp_path, "other").message
    recorder.publish([0, 1, 4, 5])
    stopped = recorder.stop(last_sample=239)
    assert (stopped.samples, stopped.missing_samples) == (160, 80)
    assert read_recording(stopped.path).gaps == [(80, 80)]


def test_a_client_that_began_anew_leaves_no_recording_open(recorder, tmp_path):
    def mortal():
        return rclpy.create_node("mortal", namespace=NAMESPACE, context=recorder.node.context)

    client = mortal()
    assert recorder.start(tmp_path, "run", client=f"{NAMESPACE}/mortal").success
    # They come once a second: by the third the recorder takes no other for whom it records for.
    started = len(recorder.diagnostics)
    recorder.until(lambda: len(recorder.diagnostics) >= started + 3)
    client.destroy_node()
    client = mortal()
    recorder.until(lambda: any(
        status.level == DiagnosticStatus.ERROR and "mortal is gone" in status.message
        for status in recorder.diagnostics))
    assert recorder.start(tmp_path, "other", client=f"{NAMESPACE}/mortal").success
    client.destroy_node()


@pytest.mark.parametrize("kind", [Processes])  # whose end is that of a user's recorder
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_closes_the_recording(recorder, tmp_path, number):
    started = recorder.start(tmp_path, "run")
    recorder.publish(range(3))
    recorder.until(lambda: any(
        ("samples", "120") in [(value.key, value.value) for value in status.values]
        for status in recorder.diagnostics))
    recorder.process.send_signal(number)
    assert recorder.process.wait(TIMEOUT_S) == 0
    recording = read_recording(started.path)
    assert recording.complete
    assert len(recording.voltage_v) == 120


def test_deactivation_closes_the_recording(recorder, tmp_path):
    assert recorder.start(tmp_path, "run").success
    transition = Transition(id=Transition.TRANSITION_DEACTIVATE)
    assert recorder.call(ChangeState, "recorder/change_state", transition=transition).success
    assert "is not active" in recorder.start(tmp_path, "other").message
    assert (tmp_path / "run" / "run_0.mcap").read_bytes().endswith(b"\x89MCAP0\r\n")


def test_a_full_disk_closes_the_recording(recorder, tmp_path):
    started = recorder.start(tmp_path, "run")
    recorder.publish(range(3))
    parameter = Parameter("minimum_free_mb", value=1_000_000_000).to_parameter_msg()
    recorder.call(SetParameters, "recorder/set_parameters", parameters=[parameter])
    recorder.until(lambda: any(
        status.level == DiagnosticStatus.ERROR and "free on the disk" in status.message
        for status in recorder.diagnostics))
    assert len(read_recording(started.path).voltage_v) == 120
    stopped = recorder.stop(last_sample=119)
    assert not stopped.success
    assert "closed early" in stopped.message
    assert stopped.path == started.path
    assert "make room" in recorder.start(tmp_path, "other").message
