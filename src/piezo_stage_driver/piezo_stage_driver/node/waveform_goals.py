# SPDX-License-Identifier: BSD-3-Clause
"""The action ``play_waveform`` of the stage node."""

import functools
import threading
import time
from collections.abc import Callable

from piezo_interfaces.action import PlayWaveform
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node

from piezo_ros.deadlines import why_too_late
from piezo_ros.quality import PROGRESS
from piezo_stage_driver.engine.stage_engine import StageEngine
from piezo_stage_driver.safety.commands import Command
from piezo_stage_driver.safety.open_answers import OpenAnswers
from piezo_stage_driver.safety.transitions import Event

PROGRESS_PERIOD_S = 0.1


class WaveformGoal:
    """One goal, from the command until its answer; see ``safety.supervisor.Goal``.

    It calls ``answer(goal, result)`` once, from any thread.
    """

    def __init__(self, handle: ServerGoalHandle,
                 answer: Callable[["WaveformGoal", PlayWaveform.Result], None]) -> None:
        self.handle = handle
        self.refused = False
        self._answer = answer
        self._result = PlayWaveform.Result()
        self._answered = threading.Lock()
        self._reported = "", 0.0

    @property
    def cancelled(self) -> bool:
        """Whether the client has requested its end."""
        return self.handle.is_cancel_requested

    def begin(self, value: tuple[int, int], error: ValueError | None) -> None:
        """Handle the answer to the command."""
        if error is not None:
            self.refused = True
            self._finish(f"waveform refused: {error}")
        else:
            self._result.first_sample, self._result.samples = value

    def attend(self, engine: StageEngine) -> None:
        """Report the progress from time to time, and each new phase, however short."""
        (phase, reported_s), now_s = self._reported, time.monotonic()
        if phase == engine.phase_name and now_s - reported_s < PROGRESS_PERIOD_S:
            return
        self._reported = engine.phase_name, now_s
        self.handle.publish_feedback(PlayWaveform.Feedback(
            stage=engine.phase_name, fraction=float(engine.fraction),
            seconds_left=float(engine.seconds_left)))

    def end(self, cause: str, last_sample: int) -> None:
        """Handle the end; the cause is empty if the waveform was played to its end."""
        self._result.last_sample = last_sample
        self._finish(cause)

    def _finish(self, message: str) -> None:
        # rclpy ends the process if a goal is answered twice.
        if self._answered.acquire(blocking=False):
            self._result.message, self._result.success = message, not message
            self._answer(self, self._result)


class WaveformGoals:
    """Serve the action: one goal at a time; others are refused. A goal submits one command."""

    def __init__(self, node: Node, submit: Callable[[Command], None]) -> None:
        self._node, self._submit = node, submit
        self._open_answers = OpenAnswers()
        self._server = ActionServer(
            node, PlayWaveform, "play_waveform", self._end,
            goal_callback=self._examine, handle_accepted_callback=self._accept,
            cancel_callback=lambda handle: CancelResponse.ACCEPT,
            feedback_pub_qos_profile=PROGRESS)

    @property
    def answered(self) -> bool:
        """Whether the clients of all goals that ended have their answers."""
        return self._open_answers.none

    def _examine(self, goal: PlayWaveform.Goal) -> GoalResponse:
        """Accept every goal whose client waits, so that its result can explain a refusal."""
        reason = why_too_late(goal)
        if reason:
            self._node.get_logger().warning(f"waveform rejected: {reason}")
        return GoalResponse.REJECT if reason else GoalResponse.ACCEPT

    def _accept(self, handle: ServerGoalHandle) -> None:
        wanted, goal = handle.request, WaveformGoal(handle, self._answer)
        self._submit(Command(
            Event.PLAY, lambda stage: stage.play(
                wanted.voltage_v, wanted.sample_period_s, wanted.repeats, wanted.hold_at_end,
                wanted.client, wanted.axes, wanted.marks),
            on_done=goal.begin, goal=goal))

    def _answer(self, goal: WaveformGoal, result: PlayWaveform.Result) -> None:
        """Execute a goal when it is over, as the executor polls a goal that waits."""
        if goal.refused:
            self._node.get_logger().warning(result.message)
        executor = self._node.executor
        if executor is None:  # the node has ended without waiting any longer
            return
        self._open_answers.begin()
        executor.create_task(goal.handle.execute, functools.partial(self._end, result=result))

    def _end(self, handle: ServerGoalHandle, result: PlayWaveform.Result) -> PlayWaveform.Result:
        self._open_answers.end()
        if handle.is_cancel_requested:
            result.success, result.message = False, "the waveform was cancelled"
            handle.canceled()
        elif result.success:
            handle.succeed()
        else:
            handle.abort()
        return result
