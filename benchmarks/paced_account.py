# SPDX-License-Identifier: BSD-3-Clause
"""What every account of a paced stage keeps: samples that are lost, and the stage's diagnostics."""

from diagnostic_msgs.msg import DiagnosticArray
from piezo_interfaces.msg import SampleBlock

from piezo_ros.quality import PACED_SAMPLES

DIAGNOSTICS_S = 3.0


class PacedAccount:
    """Keep the account of a stage that keeps the wall clock's pace.

    Samples are lost that are missing in the sample index, because this client was more than 2 s
    late; missed feedback is counted by the stage, and `described` holds its diagnostics.
    """

    def __init__(self, client):
        self.ticks = self.lost_samples = self.missed_feedback = 0
        self.described = {}
        self._client, self._next_sample = client, None
        client.node.create_subscription(SampleBlock, "samples", self._take, PACED_SAMPLES)
        client.node.create_subscription(DiagnosticArray, "/diagnostics", self._diagnose, 10)

    def hear_diagnostics(self):
        """Wait until the stage has told of the whole run."""
        self._client.spin_until(lambda: False, DIAGNOSTICS_S)

    def account(self, block):
        """Take a block of the run."""
        raise NotImplementedError

    def rest(self):
        """Take note that a block was none of a run."""

    def _take(self, block):
        if self._next_sample is not None:
            self.lost_samples += block.first_sample - self._next_sample
        self._next_sample = block.first_sample + len(block.voltage_v)
        if block.flags & SampleBlock.FLAG_TRACKING:
            self.missed_feedback = block.missed_feedback
            self.account(block)
        else:
            self.rest()

    def _diagnose(self, message):
        for status in message.status:
            if status.name.endswith("/stage: stage"):
                self.described = {value.key: value.value for value in status.values}
