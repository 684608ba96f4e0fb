# SPDX-License-Identifier: BSD-3-Clause
"""Serve actions whose work takes long: one goal at a time, in a thread of its own."""

import functools
import threading
import time
import traceback

from rclpy.action import ActionServer, CancelResponse

from piezo_node_tools.calls import Cancelled


class Progress:
    """What the work reports while it runs, and whether it shall end."""

    def __init__(self, goal_handle, feedback_type, ending):
        self._goal_handle = goal_handle
        self._feedback_type = feedback_type
        self._ending = ending
        self._begin_s = time.monotonic()

    @property
    def cancelled(self):
        """Whether the work shall end early."""
        return self._goal_handle.is_cancel_requested or self._ending.is_set()

    def check(self):
        """Raise ``Cancelled`` if the work shall end early."""
        if self.cancelled:
            raise Cancelled

    def report(self, fraction, **fields):
        """Publish feedback; the seconds left are estimated from the time taken so far."""
        taken_s = time.monotonic() - self._begin_s
        left_s = taken_s * (1.0 - fraction) / fraction if fraction > 0.0 else 0.0
        self._goal_handle.publish_feedback(self._feedback_type(
            fraction=float(fraction), seconds_left=float(left_s), **fields))


class GoalServers:
    """Actions of one node, of which one goal runs at a time.

    Parameters
    ----------
    node : rclpy.node.Node
    """

    def __init__(self, node):
        self._node = node
        self._one_at_a_time = threading.Lock()
        self._ending = threading.Event()
        self._servers = []

    @property
    def busy(self):
        """Whether a goal runs."""
        return self._one_at_a_time.locked()

    def serve(self, action_type, name, work):
        """Serve an action whose result has ``success`` and ``message``.

        Parameters
        ----------
        action_type : type
        name : str
        work : callable
            ``work(goal, result, progress)`` fills in the result. A ValueError aborts the
            goal with its text as the message; ``Cancelled`` cancels it.
        """
        self._servers.append(ActionServer(
            self._node, action_type, name, self._end_goal,
            handle_accepted_callback=lambda goal: self._begin_goal(goal, action_type, work),
            cancel_callback=lambda goal: CancelResponse.ACCEPT))

    def end(self):
        """Ask the running goal to end; return whether none runs any more."""
        self._ending.set()
        return not self.busy

    def _begin_goal(self, goal_handle, action_type, work):
        result = action_type.Result()
        if not self._one_at_a_time.acquire(blocking=False):
            result.message = f"{self._node.get_name()} is busy with another goal: wait or cancel it"
            self._node.get_logger().warning(result.message)
            self._answer_goal(goal_handle, result, "abort")
            return
        progress = Progress(goal_handle, action_type.Feedback, self._ending)
        threading.Thread(
            target=self._work, args=(work, goal_handle, result, progress), name="goal").start()

    def _answer_goal(self, goal_handle, result, end, release=False):
        """Execute a goal now that it is over: the executor polls, busily, a goal that waits."""
        self._node.executor.create_task(goal_handle.execute, functools.partial(
            self._end_goal, result=result, end=end, release=release))

    def _end_goal(self, goal_handle, result, end, release):
        if release:
            self._one_at_a_time.release()
        getattr(goal_handle, end)()
        return result

    def _work(self, work, goal_handle, result, progress):
        end = "abort"
        try:
            work(goal_handle.request, result, progress)
            result.success, end = True, "succeed"
        except Cancelled:
            result.message = "cancelled"
            # A goal that ends with its node was never asked to be cancelled.
            end = "abort" if self._ending.is_set() else "canceled"
        except ValueError as error:
            result.message = str(error)
            self._node.get_logger().warning(f"goal refused or failed: {error}")
        except Exception as error:
            result.message = f"internal error: {error!r}"
            self._node.get_logger().error(traceback.format_exc())
        self._answer_goal(goal_handle, result, end, release=True)
