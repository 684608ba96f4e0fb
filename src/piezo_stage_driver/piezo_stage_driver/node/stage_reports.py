# SPDX-License-Identifier: BSD-3-Clause
"""Reports of the stage's status to the log and to diagnostics."""

from collections.abc import Callable

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node

from piezo_ros.stage_runs.stage_watch import ACTIVE
from piezo_stage_driver.engine.answer_latency import AnswerLatency
from piezo_stage_driver.engine.tick_times import TickTimes
from piezo_stage_driver.node.stage_loop import StageLoop
from piezo_stage_driver.node.stage_outputs import StageOutputs
from piezo_stage_driver.safety.guards import StopLatch
from piezo_stage_driver.safety.supervisor import UNSAFE


class StageReports:
    """The log of stops, and the stage's status on ``/diagnostics``.

    `latency` is that of the answers since the stage was activated. `tick_times` is the timing of a
    stage that is paced by its backend's clock; None for any other.
    """

    def __init__(self, node: Node, outputs: StageOutputs, latch: StopLatch,
                 loop: Callable[[], StageLoop | None]) -> None:
        self._node, self._outputs, self._latch, self._loop = node, outputs, latch, loop
        self._reported_cause = ""
        self.latency = AnswerLatency()
        self.tick_times: TickTimes | None = None

    def report_stop(self) -> None:
        """Log a stop that has occurred since the last call; called from both threads."""
        cause, reported = self._latch.cause, self._reported_cause
        self._reported_cause = cause
        if cause and cause != reported:
            self._node.get_logger().error(f"stopped: {cause}")
            self.publish()

    def publish(self) -> None:
        """Publish the stage's status."""
        loop = self._loop()
        level, message = self._state(loop)
        if loop is not None and (loop.supervisor.hangs or not (
                loop.supervisor.active or loop.supervisor.at_rest)):
            level, message = DiagnosticStatus.ERROR, f"{message}; {UNSAFE}"
        active = loop is not None and loop.active
        self._outputs.publish_diagnostics(level, message, {ACTIVE: active} if loop is None else {
            ACTIVE: active, "phase": loop.engine.phase_name if active else "not active",
            "client": loop.engine.client, "seconds_left": f"{loop.engine.seconds_left:.3f}",
            "voltage_v": " ".join(f"{volt:.4f}" for volt in np.ravel(loop.engine.voltage_v)),
            "next_sample": loop.engine.next_sample,
            "missed_feedback": loop.engine.missed_feedback, **loop.supervisor.described,
            **self.latency.described("answers", "longest_answer_ms"), **self._pace(loop)})

    def _pace(self, loop: StageLoop) -> dict[str, object]:
        if self.tick_times is None:
            return {}
        return {**self.tick_times.described(), "real_time": loop.real_time.status}

    def _state(self, loop: StageLoop | None) -> tuple[bytes, str]:
        if self._latch.cause:
            return DiagnosticStatus.ERROR, self._latch.cause
        if loop is None or not loop.active:
            return DiagnosticStatus.OK, "not active"
        if loop.engine.missed_feedback:
            return DiagnosticStatus.WARN, "feedback answers were missed"
        return DiagnosticStatus.OK, loop.engine.phase_name
