# SPDX-License-Identifier: BSD-3-Clause
"""Call services and actions from a thread while the executor spins in another."""

import queue
import threading

from rclpy.action import ActionClient

# Long enough for a stage that is still compiling its simulation.
CALL_TIMEOUT_S = 60.0
POLL_S = 0.05
# A node that ends may be gone before its answer is read.
LAST_ANSWER_S = 1.0


class CallFailed(ValueError):
    """A service or an action did not do what it was asked to."""


class Cancelled(Exception):
    """The work was cancelled from outside."""


def call_service(client, request, timeout_s=CALL_TIMEOUT_S):
    """Call a service whose response has ``success`` and ``message``.

    Parameters
    ----------
    client : rclpy.client.Client
    request : message
    timeout_s : float
        For the service to be there, and again for its response.

    Returns
    -------
    response : message

    Raises
    ------
    CallFailed
        If nobody serves or answers, or if the response says so.
    """
    if not client.wait_for_service(timeout_s):
        raise CallFailed(f"nobody serves {client.srv_name}: start its node")
    response = _result(client.call_async(request), timeout_s, client.srv_name)
    if not response.success:
        raise CallFailed(response.message)
    return response


class ActionCaller:
    """Send goals to one action and wait for them.

    Parameters
    ----------
    node : rclpy.node.Node
    action_type : type
    name : str
    """

    def __init__(self, node, action_type, name):
        self._node = node
        self._name = name
        self._client = ActionClient(node, action_type, name)

    def run(self, goal, on_feedback=None, cancelled=lambda: False):
        """Run one goal to its end.

        Parameters
        ----------
        goal : message
        on_feedback : callable, optional
            Called with each feedback message.
        cancelled : callable
            Asked now and then; true cancels the goal, whose end is still waited for.

        Returns
        -------
        result : message
            Of a cancelled goal as well.

        Raises
        ------
        CallFailed
            If nobody serves the action, or the goal was refused or aborted.
        """
        if not self._client.wait_for_server(CALL_TIMEOUT_S):
            raise CallFailed(f"nobody serves {self._name}: start its node")
        sent = self._in_executor(lambda: self._client.send_goal_async(
            goal, feedback_callback=lambda m: on_feedback(m.feedback) if on_feedback else None))
        handle = _result(sent, CALL_TIMEOUT_S, self._name)
        if not handle.accepted:
            raise CallFailed(f"{self._name} rejected the goal: send it again")
        result = self._wait(handle, cancelled).result
        if not result.success and not cancelled():
            raise CallFailed(result.message)
        return result

    def _wait(self, handle, cancelled):
        future, finished = self._in_executor(handle.get_result_async), threading.Event()
        future.add_done_callback(lambda _: finished.set())
        asked = False
        while not finished.wait(POLL_S):
            if not self._client.server_is_ready() and not finished.wait(LAST_ANSWER_S):
                raise CallFailed(f"the node that serves {self._name} has ended: start it again")
            if cancelled() and not asked:
                self._in_executor(handle.cancel_goal_async)
                asked = True
        return future.result()

    def _in_executor(self, send):
        """Send from the executor's thread, between two callbacks.

        From another thread the answer may come before rclpy has noted what it answers.
        """
        sent = queue.SimpleQueue()
        self._node.executor.create_task(lambda: sent.put(send()))
        return sent.get()


def _result(future, timeout_s, name):
    finished = threading.Event()
    future.add_done_callback(lambda _: finished.set())
    if not finished.wait(timeout_s):
        raise CallFailed(f"{name} did not answer within {timeout_s:g} s: "
                         "look at its node's log")
    return future.result()
