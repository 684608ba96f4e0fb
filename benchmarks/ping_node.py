# SPDX-License-Identifier: BSD-3-Clause
"""Send a block of samples every tick, wait for its answer, and write the round trips."""

import array
import signal
import time

import numpy as np
from piezo_interfaces.msg import FeedbackVoltage, SampleBlock
from rclpy.node import Node

from piezo_ros.parameters import declare
from piezo_ros.quality import FEEDBACK, SAMPLES
from piezo_ros.spinning import run_node

SAMPLES_PER_TICK = 40
TICK_S = 1e-3


class PingNode(Node):
    """Ends its process after so many round trips."""

    def __init__(self):
        super().__init__("ping")
        self._file = declare(self, "round_trips_file", "", "Where to write (npy).")
        self._count = declare(self, "count", 1000, "How many round trips.")
        self._round_trips_s = array.array("d")
        samples = array.array("d", np.linspace(0.0, 1.0, SAMPLES_PER_TICK).tobytes())
        self._block = SampleBlock(voltage_v=samples, displacement_um=samples)
        self._samples = self.create_publisher(SampleBlock, "samples", SAMPLES)
        self._answers = self.create_subscription(
            FeedbackVoltage, "feedback", self._on_answer, FEEDBACK)
        self._begin = self.create_timer(0.1, self._send_when_connected)

    def _send_when_connected(self):
        if self._samples.get_subscription_count() and self._answers.get_publisher_count():
            self._begin.cancel()
            self._send()

    def _send(self):
        self._sent_at_s = time.perf_counter()
        self._samples.publish(self._block)

    def _on_answer(self, message):
        self._round_trips_s.append(time.perf_counter() - self._sent_at_s)
        if len(self._round_trips_s) < self._count:
            time.sleep(max(0.0, self._sent_at_s + TICK_S - time.perf_counter()))
            self._send()
        else:
            signal.raise_signal(signal.SIGINT)

    def close(self):
        """Write the round trips."""
        np.save(self._file, np.array(self._round_trips_s))


if __name__ == "__main__":
    run_node(PingNode)
