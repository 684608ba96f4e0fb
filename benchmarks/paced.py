# SPDX-License-Identifier: BSD-3-Clause
"""Run the stage at 1 kHz of wall-clock time: python paced.py [SECONDS].

A client of its own process answers every block. Every sample is accounted for: the feedforward
exactly as uploaded, plus an answer that was sent; an answer that came too late is counted.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from paced_account import PacedAccount
from piezo_interfaces.msg import FeedbackVoltage, SampleBlock
from piezo_interfaces.srv import LoadFeedforward, StartTracking

from piezo_bringup.processes import Processes
from piezo_client.client import Client
from piezo_ros.quality import FEEDBACK

TICKS_PER_S = 1000
SAMPLES_PER_TICK = 40
PERIOD_V = 50.0 - 50.0 * np.cos(2 * np.pi * np.arange(4000) / 4000)
ANSWER_V = 0.001


def answer_v(tick):
    """Return the answer to a block: another one for every tick of a second."""
    return ANSWER_V * (tick % TICKS_PER_S)


class PacedRun(PacedAccount):
    """Answers the blocks of a run and keeps the account of it; see `PacedAccount`.

    Ticks are disturbed that had another voltage than feedforward and an answer, and held that were
    flagged as without an answer.
    """

    def __init__(self, client):
        self.disturbed_ticks = self.held_ticks = 0
        self.over = False
        self._held_v = self._first_sample = self._expected_sample = None
        self._feedback = client.node.create_publisher(FeedbackVoltage, "feedback", FEEDBACK)
        super().__init__(client)

    @property
    def histogram(self):
        """Answers by how late they came."""
        return {name: count for name, count in self.described.items() if "answer" in name}

    def run(self, duration_s):
        """Track for a time (s) of the wall clock."""
        client = self._client
        client.spin_until(lambda: self._feedback.get_subscription_count(), 30.0)
        client.spin_until(lambda: self._next_sample, 30.0)
        loaded = client.call(LoadFeedforward, "load_feedforward",
                             period_voltage_v=PERIOD_V.tolist())
        started = client.call(StartTracking, "start_tracking", feedback=True,
                              ticks=round(duration_s * TICKS_PER_S))
        if not (loaded.success and started.success):
            raise RuntimeError(loaded.message or started.message)
        client.spin_until(lambda: self.over, 2.0 * duration_s + 30.0)
        self.hear_diagnostics()

    def rest(self):
        """Take note that the run is over, if it had begun."""
        self.over = self.over or self.ticks > 0

    def account(self, block):
        """Answer a block, and compare what it played."""
        self._feedback.publish(FeedbackVoltage(tick=block.tick, voltage_v=answer_v(block.tick)))
        held = bool(block.flags & SampleBlock.FLAG_FEEDBACK_HELD)
        if self._first_sample is None:
            self._first_sample = block.first_sample
        at = block.first_sample - self._first_sample
        if block.first_sample != self._expected_sample:
            self._held_v = None  # blocks that this client was too late to read told it
        if not held:
            # In the block of tick k, published in tick k + 1, acts the answer to that of k - 1.
            self._held_v = answer_v(block.tick - 2) if at > SAMPLES_PER_TICK else 0.0
        if self._held_v is not None:
            begin = at % len(PERIOD_V)
            wanted_v = PERIOD_V[begin:begin + SAMPLES_PER_TICK] + self._held_v
            self.disturbed_ticks += not np.array_equal(np.frombuffer(block.voltage_v), wanted_v)
        self._expected_sample = block.first_sample + SAMPLES_PER_TICK
        self.held_ticks += held
        self.ticks += 1


def paced_run(directory, duration_s):
    """Run the simulated stage in paced mode; return the `PacedRun`."""
    with Processes(directory) as processes, Client() as client:
        processes.start("stage", {"autostart": True, "timing": "paced",
                                  "max_missed_feedback": 10000})
        run = PacedRun(client)
        run.run(duration_s)
        return run


def main():
    """Print the account."""
    duration_s = float(sys.argv[1]) if len(sys.argv) > 1 else 600.0
    with tempfile.TemporaryDirectory() as directory:
        run = paced_run(Path(directory), duration_s)
    print(f"{run.ticks} ticks in {duration_s:g} s; samples lost {run.lost_samples}, "
          f"ticks disturbed {run.disturbed_ticks}")
    print(f"answers missed {run.missed_feedback}, flagged {run.held_ticks}")
    for name, count in run.histogram.items():
        print(f"{name:26}{count:>12}")


if __name__ == "__main__":
    main()
