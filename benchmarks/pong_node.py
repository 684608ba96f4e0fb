# SPDX-License-Identifier: BSD-3-Clause
"""Answer every block of samples at once."""

from piezo_interfaces.msg import FeedbackVoltage, SampleBlock
from rclpy.node import Node

from piezo_ros.quality import FEEDBACK, SAMPLES
from piezo_ros.spinning import run_node


class PongNode(Node):
    """The other side of the ping-pong."""

    def __init__(self):
        super().__init__("pong")
        self._feedback = self.create_publisher(FeedbackVoltage, "feedback", FEEDBACK)
        self.create_subscription(SampleBlock, "samples", self._on_samples, SAMPLES)

    def _on_samples(self, block):
        self._feedback.publish(FeedbackVoltage(tick=block.tick))


if __name__ == "__main__":
    run_node(PongNode)
