# SPDX-License-Identifier: BSD-3-Clause
"""Topics that the stage node publishes."""

import array
import time

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from piezo_interfaces.msg import AppliedFeedback, Marks, SampleBlock, StageDescription
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from piezo_ros.diagnostics import diagnostic
from piezo_ros.quality import DESCRIPTION, FEEDBACK, PACED_SAMPLES, SAMPLES
from piezo_stage_driver.engine.blocks import Block
from piezo_stage_driver.node.stage_settings import StageSettings

NANOSECONDS = 1_000_000_000
# The middleware requests acknowledgements every 3 s.
DELIVERY_TIMEOUT_S = 5.0
# ROS gives up a dead subscriber after 20 s.
LONGEST_HOLD_BACK_S = 30.0


class StageOutputs:
    """Publishers of the samples, the description, the joint state, the clock and the diagnostics.

    `epoch_ns` is the ROS time of sample 0; axes are named if there are several.
    """

    def __init__(self, node: Node, settings: StageSettings) -> None:
        self._node, self._settings = node, settings
        self.epoch_ns = 0
        self.axes: list[str] = []
        self.signals: list[str] = []
        self.quality = SAMPLES if settings.lockstep else PACED_SAMPLES
        self._samples = node.create_publisher(SampleBlock, "samples", self.quality)
        self._applied_feedback = node.create_publisher(
            AppliedFeedback, "applied_feedback", FEEDBACK)
        self._marks = node.create_publisher(Marks, "marks", self.quality)
        self._joint_states = node.create_publisher(JointState, "joint_states", 10)
        self._diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._clock = node.create_publisher(Clock, "/clock", 10) if settings.lockstep else None
        self._description: Publisher | None = None
        self._losing_samples = False
        self._samples_since_joint_state = self._samples_since_clock = 0

    def describe(self, description: StageDescription) -> None:
        """Publish the description of the stage, also for later subscribers, until withdrawn."""
        self.axes = [axis.name for axis in description.axes]
        self.signals = list(description.signals)
        self._description = self._node.create_publisher(
            StageDescription, "stage/description", DESCRIPTION)
        self._description.publish(description)

    def withdraw_description(self) -> None:
        """Withdraw the description of a stage that is no longer configured."""
        if self._description is not None:
            self._node.destroy_publisher(self._description)
            self._description = None

    def stamp(self, sample: int) -> Time:
        """Return the time of a sample of the clock."""
        nanoseconds = self.epoch_ns + round(sample / self._settings.sample_rate_hz * NANOSECONDS)
        return Time(sec=nanoseconds // NANOSECONDS, nanosec=nanoseconds % NANOSECONDS)

    def publish_block(self, block: Block, next_sample: int, idle: bool) -> None:
        """Publish a block, with the messages that general tools use, before a sample of the clock.

        `idle` tells that nothing follows at present.
        """
        message = SampleBlock(
            first_sample=block.first_sample, sample_period_s=block.sample_period_s,
            tick=block.tick, flags=block.flags, missed_feedback=block.missed_feedback,
            axes=self.axes,
            voltage_v=array.array("d", block.voltage_v.tobytes()),
            displacement_um=array.array("d", block.displacement_um.tobytes()))
        if block.signal is not None:
            message.signals = self.signals
            message.signal = array.array("d", block.signal.tobytes())
        if block.marks is not None:
            message.marks = array.array("B", block.marks.tobytes())
            self._publish_marks(block, block.marks)
        self.publish_samples(self._samples, message)
        if block.feedback_v is not None:
            feedback = AppliedFeedback(first_sample=block.first_sample,
                                       voltage_v=array.array("d", block.feedback_v.tobytes()))
            feedback.header.stamp = self.stamp(block.first_sample)
            self._applied_feedback.publish(feedback)
        samples = len(block.voltage_v) * round(
            block.sample_period_s * self._settings.sample_rate_hz)
        self._publish_joint_state(block, samples, next_sample)
        if self._clock is not None:
            self._publish_clock(self._clock, samples, next_sample, idle)

    def _publish_marks(self, block: Block, marks: np.ndarray) -> None:
        marked = np.flatnonzero(marks)
        stride = round(block.sample_period_s * self._settings.sample_rate_hz)
        samples = block.first_sample + stride * marked
        message = Marks(sample=samples.tolist(), stamp=[*map(self.stamp, samples.tolist())],
                        kind=array.array("B", marks[marked].tobytes()))
        message.header.stamp = message.stamp[0]
        self._publish(self._marks, message)

    def publish_samples(self, publisher: Publisher, message: SampleBlock) -> None:
        """Publish; in lockstep wait for a slow subscriber, for a limited time."""
        message.header.stamp = self.stamp(message.first_sample)
        self._publish(publisher, message)

    def _publish(self, publisher: Publisher, message: SampleBlock | Marks) -> None:
        message.header.frame_id = self._settings.joint_name
        patient = self._settings.lockstep and not self._losing_samples
        deadline = time.monotonic() + (LONGEST_HOLD_BACK_S if patient else 0.0)
        while True:
            try:
                publisher.publish(message)
                self._losing_samples = False
                return
            except RuntimeError:  # of ROS: a subscriber made no room within 0.1 s
                if time.monotonic() < deadline:
                    continue
            if not self._losing_samples:
                self._node.get_logger().error(
                    f"samples are lost: a subscriber of {publisher.topic_name} hangs, end it")
            self._losing_samples = True
            return

    def _publish_joint_state(self, block: Block, samples: int, next_sample: int) -> None:
        self._samples_since_joint_state += samples
        if (self._samples_since_joint_state * self._settings.joint_state_rate_hz
                < self._settings.sample_rate_hz):
            return
        self._samples_since_joint_state = 0
        joint = self._settings.joint_name
        message = JointState(name=[f"{joint}_{axis}" for axis in self.axes] or [joint],
                             position=np.ravel(block.displacement_um[-1] * 1e-6).tolist())
        message.header.stamp = self.stamp(next_sample)
        self._joint_states.publish(message)

    def _publish_clock(self, clock: Publisher, samples: int, next_sample: int,
                       idle: bool) -> None:
        self._samples_since_clock += samples
        if self._samples_since_clock < self._settings.sample_rate_hz / 100 and not idle:
            return
        self._samples_since_clock = 0
        clock.publish(Clock(clock=self.stamp(next_sample)))

    def publish_diagnostics(self, level: bytes, message: str, values: dict[str, object]) -> None:
        """Publish the status of the stage."""
        self._diagnostics.publish(diagnostic(
            self._node, "stage", level, message, values, self._settings.joint_name))

    def wait_for_delivery(self) -> None:
        """Wait until subscribers have received the last samples, before the process ends."""
        self._samples.wait_for_all_acked(Duration(seconds=DELIVERY_TIMEOUT_S))
