# SPDX-License-Identifier: BSD-3-Clause
"""Serve actions with long work: one goal at a time, each in its own thread."""

import functools
import threading
import time
import traceback
from collections.abc import Callable
from enum import StrEnum
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode, LifecycleState, ManagedEntity, TransitionCallbackReturn

from piezo_common.cancellation import checking
from piezo_ros.clock_guard import keep_clock
from piezo_ros.deadlines import why_too_late
from piezo_ros.diagnostics import diagnostic
from piezo_ros.messages import Message, MessageType
from piezo_ros.presence import Presence
from piezo_ros.quality import PROGRESS
from piezo_ros.requests.calls import Cancelled, InvalidHandle

DIAGNOSTICS_PERIOD_S = 1.0
GOAL = "goal"
"""Key of the `GoalState` among the values of the diagnostics."""


class GoalState(StrEnum):
    """Work state of a node that serves actions."""

    NONE = "none"
    BUSY = "busy"
    NOT_ACTIVE = "not active"


class Progress:
    """Reports of the work while it runs, and requests to end it.

    The function returns why the server ends its goals; empty if it does not.
    """

    def __init__(self, goal_handle: ServerGoalHandle, feedback_type: MessageType, client: Presence,
                 why_ending: Callable[[], str]) -> None:
        self._goal_handle = goal_handle
        self._feedback_type = feedback_type
        self._client = client
        self._why_ending = why_ending
        self._begin_s = time.monotonic()
        self._fraction, self._left_s, self._step = 0.0, 0.0, "begins"

    @property
    def account(self) -> str:
        """Return the client of the work, and its progress at the last report."""
        client = f" for {self._client.name}" if self._client.name else ""
        left = f", {100 * self._fraction:.0f} %, {self._left_s:.3g} s left"
        return f"{client} ({self._step}{left if self._fraction else ''})"

    @property
    def cause(self) -> str:
        """Return why the work must end early; empty if it need not."""
        if self._goal_handle.is_cancel_requested:
            return "cancelled"
        if self._client.gone:
            return f"cancelled: the client {self._client.name} is gone"
        ending = self._why_ending()
        return ending and f"cancelled: {ending}"

    @property
    def cancelled(self) -> bool:
        """Return True if the work must end early."""
        return bool(self.cause)

    def check(self) -> None:
        """Raise ``Cancelled`` if the work must end early."""
        if self.cancelled:
            raise Cancelled

    def report(self, fraction: float, **fields: Any) -> None:
        """Publish feedback; the seconds left are estimated from the time taken so far."""
        taken_s = time.monotonic() - self._begin_s
        left_s = taken_s * (1.0 - fraction) / fraction if fraction > 0.0 else 0.0
        self._fraction, self._left_s = float(fraction), float(left_s)
        self._step = fields.get("stage", "") or "runs"
        self._goal_handle.publish_feedback(self._feedback_type(
            fraction=float(fraction), seconds_left=float(left_s), **fields))


Work = Callable[[Message, Message, Progress], None]
"""Function ``work(goal, result, progress)`` that fills in the result of a goal."""


class GoalServers(ManagedEntity):
    """Actions of one lifecycle node, which runs one goal at a time while it is active.

    A goal is rejected, and the reason logged, while another runs or the node is not active. A goal
    that cannot be done is aborted with a message. The goal's field ``client`` names the client's
    node; the goal is cancelled once that node is gone.
    """

    def __init__(self, node: LifecycleNode) -> None:
        self._node = node
        self._one_at_a_time = threading.Lock()
        self._active = False
        self._why_ending = ""
        self._servers: list[ActionServer] = []
        self._present: tuple[str, Progress] | None = None
        self._diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        node.create_timer(DIAGNOSTICS_PERIOD_S, self._publish,
                          clock=Clock(clock_type=ClockType.STEADY_TIME))
        node.add_managed_entity(self)
        keep_clock(node, lambda: "a goal runs" if self.busy else "")

    @property
    def busy(self) -> bool:
        """Return True if a goal runs."""
        return self._one_at_a_time.locked()

    def serve(self, action_type: MessageType, name: str, work: Work) -> None:
        """Serve an action whose result has ``success`` and ``message``.

        ``work(goal, result, progress)`` fills in the result. A ValueError aborts the goal with its
        text as the message; ``Cancelled`` cancels it.
        """
        self._servers.append(ActionServer(
            self._node, action_type, name, self._end_goal, goal_callback=self._examine,
            handle_accepted_callback=lambda goal: self._begin_goal(goal, name, action_type, work),
            cancel_callback=lambda goal: CancelResponse.ACCEPT,
            feedback_pub_qos_profile=PROGRESS))

    def end(self) -> bool:
        """Request the end of the running goal; return True if none runs any more."""
        self._why_ending = f"the node {self._node.get_fully_qualified_name()} was ended"
        return not self.busy

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Accept goals from now on."""
        self._active, self._why_ending = True, ""
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Cancel the running goal, and accept no more."""
        self._active = False
        self._why_ending = f"the node {self._node.get_fully_qualified_name()} was deactivated"
        return TransitionCallbackReturn.SUCCESS

    on_shutdown = on_deactivate

    def _examine(self, goal: Message) -> GoalResponse:
        """Return whether a goal is accepted; the response has no field for a reason."""
        reason = ""
        if late := why_too_late(goal):
            reason = f"was sent too late: {late}"
        elif self._why_ending or not self._active:
            reason = "is not active: activate it first"
        elif self.busy:
            reason = "is busy with another goal: wait or cancel it"
        if reason:
            self._node.get_logger().warning(f"goal rejected: {self._node.get_name()} {reason}")
            self._publish()
        return GoalResponse.REJECT if reason else GoalResponse.ACCEPT

    def _publish(self) -> None:
        """Publish the work state, from which rejected clients learn the reason."""
        present = self._present
        if present is not None:
            state, message = GoalState.BUSY, f"busy with {present[0]}{present[1].account}"
        elif self._why_ending or not self._active:
            state, message = GoalState.NOT_ACTIVE, "not active: activate it first"
        else:
            state, message = GoalState.NONE, "works on no goal"
        self._diagnostics.publish(diagnostic(
            self._node, "goal", DiagnosticStatus.OK, message, {GOAL: state}))

    def _begin_goal(self, goal_handle: ServerGoalHandle, name: str, action_type: MessageType,
                    work: Work) -> None:
        # The lock is free: the executor processes one goal after the other, and has just checked.
        self._one_at_a_time.acquire(blocking=False)
        client = Presence(self._node, goal_handle.request.client)
        progress = Progress(
            goal_handle, action_type.Feedback, client, lambda: self._why_ending)
        self._present = name, progress
        threading.Thread(target=self._work, name="goal", args=(
            work, goal_handle, action_type.Result(), progress)).start()

    def _end_goal(self, goal_handle: ServerGoalHandle, result: Message, end: str) -> Message:
        self._present = None
        self._one_at_a_time.release()
        getattr(goal_handle, end)()
        return result

    def _work(self, work: Work, goal_handle: ServerGoalHandle, result: Message,
              progress: Progress) -> None:
        end = "abort"
        try:
            with checking(progress.check):
                work(goal_handle.request, result, progress)
            result.success, end = True, "succeed"
        except Cancelled:
            result.message = progress.cause
            # A goal that ends for another reason has no cancel request.
            end = "canceled" if goal_handle.is_cancel_requested else "abort"
            self._node.get_logger().warning(f"goal ended early: {result.message}")
        except ValueError as error:
            result.message = str(error)
            self._node.get_logger().warning(f"goal refused or failed: {error}")
        except MemoryError:
            result.message = ("this takes more memory than the node may have: give less data, or "
                              "start the node with a larger memory_limit_percent")
            self._node.get_logger().error(result.message)
        except InvalidHandle:  # the node has ended without waiting
            return
        except Exception as error:
            result.message = f"internal error: {error!r}"
            self._node.get_logger().error(traceback.format_exc())
        executor = self._node.executor
        if executor is not None:  # it is None after the node has ended
            # Executed only now that the work is over: the executor polls a waiting goal
            # continuously.
            executor.create_task(goal_handle.execute, functools.partial(
                self._end_goal, result=result, end=end))
