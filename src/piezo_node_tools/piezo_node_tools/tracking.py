# SPDX-License-Identifier: BSD-3-Clause
"""Let the stage play a feedforward, and answer its blocks meanwhile."""

import array
import threading
from contextlib import suppress

from piezo_interfaces.msg import FeedbackVoltage, SampleBlock
from piezo_interfaces.srv import LoadFeedforward, StartTracking
from rclpy.serialization import deserialize_message
from std_srvs.srv import Trigger

from piezo_node_tools.calls import CallFailed, call_service
from piezo_node_tools.quality import FEEDBACK, SAMPLES

REPORT_PERIOD_S = 0.1
SILENCE_TIMEOUT_S = 10.0


class StageTracker:
    """Run the stage's feedforward and feedback, one run at a time.

    Parameters
    ----------
    node : rclpy.node.Node

    Attributes
    ----------
    last_sample : int
        Of the last run, its way back to rest included; 0 until the stage is at rest again.
    missed_feedback : int
        Answers of the last run that the stage missed.
    """

    def __init__(self, node):
        self._take = None
        self._client = node.get_fully_qualified_name()
        self._at_rest = threading.Event()
        self.last_sample = self.missed_feedback = 0
        self._feedback = node.create_publisher(FeedbackVoltage, "feedback", FEEDBACK)
        # Raw, as nobody looks at the blocks between two runs.
        node.create_subscription(SampleBlock, "samples", self._on_samples, SAMPLES, raw=True)
        self._load = node.create_client(LoadFeedforward, "load_feedforward")
        self._start = node.create_client(StartTracking, "start_tracking")
        self._stop = node.create_client(Trigger, "stop_tracking")

    def run(self, once_voltage_v, period_voltage_v, ticks, take, answering, cancelled, report):
        """Play a feedforward for some ticks and wait until the stage is at rest.

        Parameters
        ----------
        once_voltage_v, period_voltage_v : ndarray
            See `LoadFeedforward`.
        ticks : int
        take : callable
            Takes each `SampleBlock` of the run and returns the answer to it, a voltage.
        answering : bool
            Whether the stage waits for the answers and adds them.
        cancelled : callable
            Asked now and then; true stops the run.
        report : callable
            Called now and then.

        Raises
        ------
        CallFailed
            If the stage refuses, or falls silent.
        """
        self._at_rest.clear()
        self._blocks = self.last_sample = self.missed_feedback = 0
        call_service(self._load, LoadFeedforward.Request(
            once_voltage_v=array.array("d", once_voltage_v.tobytes()),
            period_voltage_v=array.array("d", period_voltage_v.tobytes())))
        self._answering = answering
        self._take = take
        try:
            call_service(self._start, StartTracking.Request(
                feedback=answering, ticks=ticks, client=self._client))
            self._wait(cancelled, report)
        finally:
            self._take = None

    def _wait(self, cancelled, report):
        blocks_before, silent_s, stopping = 0, 0.0, False
        while not self._at_rest.wait(REPORT_PERIOD_S):
            if cancelled() and not stopping:
                stopping = True
                with suppress(CallFailed):  # the stage may just have stopped by itself
                    call_service(self._stop, Trigger.Request())
            silent_s = silent_s + REPORT_PERIOD_S if self._blocks == blocks_before else 0.0
            if silent_s > SILENCE_TIMEOUT_S:
                raise CallFailed(f"the stage sent no samples for {SILENCE_TIMEOUT_S:g} s: "
                                 "look whether its node runs")
            blocks_before = self._blocks
            report()

    def _on_samples(self, raw):
        take = self._take
        if take is None:
            return
        block = deserialize_message(raw, SampleBlock)
        if block.flags & SampleBlock.FLAG_TRACKING:
            self._blocks += 1
            self.missed_feedback = block.missed_feedback
            voltage_v = take(block)
            if self._answering:
                self._feedback.publish(FeedbackVoltage(tick=block.tick, voltage_v=voltage_v))
        elif self._blocks and not block.flags & SampleBlock.FLAG_RAMPING:
            self.last_sample = block.first_sample + len(block.displacement_um) - 1
            self._at_rest.set()
