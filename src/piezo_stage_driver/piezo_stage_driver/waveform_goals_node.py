# SPDX-License-Identifier: BSD-3-Clause
"""The action ``play_waveform`` of the stage node."""

import functools
import time

from piezo_interfaces.action import PlayWaveform
from rclpy.action import ActionServer, CancelResponse

PROGRESS_PERIOD_S = 0.1


class WaveformGoals:
    """Serve the action: one goal at a time, the others are refused.

    Parameters
    ----------
    node : rclpy.node.Node
    command : callable
        Runs a function of the engine and further arguments between two ticks; raises
        ValueError where it is refused.
    """

    def __init__(self, node, command):
        self._node, self._command = node, command
        self._goal = self._result = None
        self._unanswered = 0
        self._last_progress_s = 0.0
        self._server = ActionServer(
            node, PlayWaveform, "play_waveform", self._end,
            handle_accepted_callback=self._accept,
            cancel_callback=lambda goal: CancelResponse.ACCEPT)

    @property
    def answered(self):
        """Whether the client of every goal that ended knows."""
        return not self._unanswered

    def _accept(self, goal_handle):
        try:
            self._command(self._begin, goal_handle)
        except ValueError as error:
            message = f"waveform refused: {error}"
            self._node.get_logger().warning(message)
            self._answer(goal_handle, PlayWaveform.Result(message=message))

    def _begin(self, engine, goal_handle):
        goal, result = goal_handle.request, PlayWaveform.Result()
        result.first_sample, result.samples = engine.play(
            goal.voltage_v, goal.sample_period_s, goal.repeats, goal.hold_at_end, goal.client)
        self._goal, self._result = goal_handle, result
        self._last_progress_s = time.monotonic()

    def attend(self, engine):
        """Look whether the goal is to be cancelled, and tell how far it is."""
        goal = self._goal
        if goal is None:
            return
        if goal.is_cancel_requested and engine.phase_name != "return":
            engine.return_to_rest()
        now_s = time.monotonic()
        if now_s - self._last_progress_s < PROGRESS_PERIOD_S:
            return
        self._last_progress_s = now_s
        goal.publish_feedback(PlayWaveform.Feedback(
            stage=engine.phase_name, fraction=float(engine.fraction),
            seconds_left=float(engine.seconds_left)))

    def finish(self, message, last_sample):
        """End the goal, if there is one; the message is empty where it was played to its end."""
        if self._goal is not None:
            goal, result, self._goal, self._result = self._goal, self._result, None, None
            result.message, result.last_sample = message, last_sample
            result.success = not message
            self._answer(goal, result)

    def _answer(self, goal_handle, result):
        """Execute a goal now that it is over: the executor polls, busily, a goal that waits."""
        self._unanswered += 1
        self._node.executor.create_task(
            goal_handle.execute, functools.partial(self._end, result=result))

    def _end(self, goal_handle, result):
        self._unanswered -= 1
        if goal_handle.is_cancel_requested:
            result.success, result.message = False, "the waveform was cancelled"
            goal_handle.canceled()
        elif result.success:
            goal_handle.succeed()
        else:
            goal_handle.abort()
        return result
