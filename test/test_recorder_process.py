# SPDX-License-Identifier: BSD-3-Clause
"""The recorder as a process of its own, fed by a publisher that stands in for the stage."""

import array
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from piezo_interfaces.msg import FeedbackVoltage, SampleBlock
from piezo_interfaces.srv import StartRecording, StopRecording
from rcl_interfaces.srv import SetParameters
from rclpy.experimental import EventsExecutor
from rclpy.parameter import Parameter
from rosbags.highlevel import AnyReader

from piezo_node_tools.quality import SAMPLES
from piezo_recorder.reader import read_recording

TIMEOUT_S = 30.0
# Own namespace: nodes of other runs on this machine are not to be heard.
NAMESPACE = f"/recorder_test_{os.getpid()}"


class Stage:
    """Publisher of sample blocks, and caller of the recorder's services."""

    def __init__(self):
        self.node = rclpy.create_node("stage", namespace=NAMESPACE)
        self.executor = EventsExecutor()
        self.executor.add_node(self.node)
        self.samples = self.node.create_publisher(SampleBlock, "samples", SAMPLES)
        self.ground_truth = self.node.create_publisher(SampleBlock, "ground_truth", SAMPLES)
        self.feedback = self.node.create_publisher(FeedbackVoltage, "feedback", SAMPLES)
        self.diagnostics = []
        self.node.create_subscription(
            DiagnosticArray, "/diagnostics",
            lambda message: self.diagnostics.append(message.status[0]), 10)

    def call(self, service_type, service, **fields):
        client = self.node.create_client(service_type, service)
        self.until(client.service_is_ready)
        future = client.call_async(service_type.Request(**fields))
        self.until(future.done)
        self.node.destroy_client(client)
        return future.result()

    def start(self, directory, name, **fields):
        return self.call(StartRecording, "recorder/start_recording",
                         directory=str(directory), name=name, **fields)

    def stop(self, last_sample=0):
        return self.call(StopRecording, "recorder/stop_recording", last_sample=last_sample)

    def until(self, condition):
        deadline = time.monotonic() + TIMEOUT_S
        while not condition():
            assert time.monotonic() < deadline
            self.executor.spin_once(timeout_sec=0.02)

    def publish(self, ticks):
        for tick in ticks:
            block = SampleBlock(
                first_sample=40 * tick, sample_period_s=2.5e-5, tick=tick + 1, flags=32,
                voltage_v=array.array("d", np.full(40, tick)),
                displacement_um=array.array("d", np.arange(40.0) + tick))
            self.samples.publish(block)
            block.displacement_um = array.array("d", np.arange(40.0) - tick)
            self.ground_truth.publish(block)
            self.feedback.publish(FeedbackVoltage(tick=tick + 1, voltage_v=float(tick)))
            self.executor.spin_once(timeout_sec=0)

    def close(self):
        self.executor.remove_node(self.node)
        self.node.destroy_node()


@pytest.fixture
def stage(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    rclpy.init()
    stage = Stage()
    yield stage
    stage.close()
    rclpy.try_shutdown()


@pytest.fixture
def recorder(stage):
    process = subprocess.Popen(
        [sys.executable, "-m", "piezo_recorder.recorder_node",
         "--ros-args", "-r", f"__ns:={NAMESPACE}"], start_new_session=True)
    stage.until(lambda: all(
        publisher.get_subscription_count()
        for publisher in (stage.samples, stage.ground_truth, stage.feedback)))
    yield process
    process.kill()
    process.wait()


def test_every_message_is_recorded_and_numbers_are_told(stage, recorder, tmp_path):
    assert not stage.stop().success
    started = stage.start(tmp_path, "run", attachment_names=["model.json"],
                          attachment_contents=["{}"])
    assert started.success, started.message
    stage.publish(range(500))
    stopped = stage.stop(last_sample=40 * 500 - 1)
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
    # The answer to the last block may come when the recording is closed already.
    assert counts.pop(NAMESPACE + "/feedback") >= 499
    assert counts == {NAMESPACE + "/samples": 500, NAMESPACE + "/ground_truth": 500}

    refused = stage.start(tmp_path, "run")
    assert not refused.success
    assert "exists already" in refused.message


def test_a_gap_is_counted(stage, recorder, tmp_path):
    assert stage.start(tmp_path, "run").success
    assert "is being recorded" in stage.start(tmp_path, "other").message
    stage.publish([0, 1, 4, 5])
    stopped = stage.stop(last_sample=239)
    assert (stopped.samples, stopped.missing_samples) == (160, 80)
    assert read_recording(stopped.path).gaps == [(80, 80)]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_closes_the_recording(stage, recorder, tmp_path, number):
    started = stage.start(tmp_path, "run")
    stage.publish(range(3))
    stage.until(lambda: any(("samples", "120") in [(value.key, value.value)
                                                  for value in status.values]
                            for status in stage.diagnostics))
    recorder.send_signal(number)
    assert recorder.wait(TIMEOUT_S) == 0
    recording = read_recording(started.path)
    assert recording.complete
    assert len(recording.voltage_v) == 120


def test_deactivation_closes_the_recording(stage, recorder, tmp_path):
    started = stage.start(tmp_path, "run")
    transition = Transition(id=Transition.TRANSITION_DEACTIVATE)
    assert stage.call(ChangeState, "recorder/change_state", transition=transition).success
    assert "is not active" in stage.start(tmp_path, "other").message
    assert (tmp_path / "run" / "run_0.mcap").read_bytes().endswith(b"\x89MCAP0\r\n")
    assert started.success


def test_a_full_disk_closes_the_recording(stage, recorder, tmp_path):
    started = stage.start(tmp_path, "run")
    stage.publish(range(3))
    parameter = Parameter("minimum_free_mb", value=1_000_000_000).to_parameter_msg()
    stage.call(SetParameters, "recorder/set_parameters", parameters=[parameter])
    stage.until(lambda: any(status.level == DiagnosticStatus.ERROR
                            and "free on the disk" in status.message
                            for status in stage.diagnostics))
    assert len(read_recording(started.path).voltage_v) == 120
    stopped = stage.stop(last_sample=119)
    assert not stopped.success
    assert "closed early" in stopped.message
    assert stopped.path == started.path
    assert "make room" in stage.start(tmp_path, "other").message
