# SPDX-License-Identifier: BSD-3-Clause
"""Call services and actions from a thread while the executor spins in another."""

import math
import queue
import secrets
import time
from collections.abc import Callable
from typing import Any

from lifecycle_msgs.srv import GetState
from piezo_interfaces.srv import StartRecording, StopRecording
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    SetParameters,
)
from rclpy.action.client import ClientGoalHandle
from rclpy.client import Client
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import Trigger

from piezo_ros.deadlines import set_deadline
from piezo_ros.messages import Message, MessageType
from piezo_ros.requests.lost_answers import PatientActionClient
from piezo_ros.requests.servers import WORD_AFTER_S, Waiting, described_server

InvalidHandle = rclpy_implementation.InvalidHandle

# Long enough for a stage that is still compiling its simulation.
CALL_TIMEOUT_S = 60.0
POLL_S = 0.05
# A node that ends may be gone before its response is read.
LAST_ANSWER_S = 1.0
# A response is lost if the server has not discovered the client. Each wait is twice the last one.
RESEND_S = 2.0

IDEMPOTENT = tuple(service.Request for service in (
    StopRecording, Trigger, GetState, ListParameters, DescribeParameters, GetParameters,
    SetParameters))
"""Requests whose repetition has no further effect."""


class CallFailed(ValueError):
    """A service or an action did not do what was requested."""


class Refused(CallFailed):
    """A response reports that the service did not do what was requested."""

    def __init__(self, response: Message) -> None:
        super().__init__(response.message)
        self.response = response


class NoAnswer(CallFailed):
    """It is unknown whether a request has acted; it must not act later."""


class GoalAborted(CallFailed):
    """A goal ended without success."""

    def __init__(self, result: Message) -> None:
        super().__init__(result.message)
        self.result = result


class Cancelled(Exception):
    """The work was cancelled from outside."""


def may_be_repeated(request: Message) -> bool:
    """Return whether a request may be repeated if no response comes; number it if possible.

    A repetition has no further effect if the request has a number, or is idempotent. A recorder
    gives the same response to a repeated start by a named client, and to any stop.
    """
    if isinstance(request, StartRecording.Request):
        return bool(request.client)
    return number_request(request) or isinstance(request, IDEMPOTENT)


def number_request(request: Message) -> bool:
    """Give a request a unique number, if it has such a field and it is not set; return if it has.

    The server acts once for each number, so that such a request may be repeated.
    """
    if getattr(request, "request_id", None) == 0:
        request.request_id = secrets.randbits(63) + 1
    return hasattr(request, "request_id")


def call_service(node: Node, client: Client, request: Message, timeout_s: float = CALL_TIMEOUT_S,
                 appearance_s: float = CALL_TIMEOUT_S) -> Message:
    """Call a service whose response has ``success`` and ``message``; times are in s.

    A request is repeated if no response comes and `may_be_repeated` allows it. If it has a field
    for a deadline, it does not act after its client has stopped waiting. Raises `CallFailed` if
    there is no server, or if its node or this one ends meanwhile, `Refused` if the response reports
    a failure, and `NoAnswer` if no response comes.
    """
    repeatable = may_be_repeated(request)
    _await_service(node, client.wait_for_service, client.srv_name, appearance_s)
    set_deadline(request, timeout_s)
    response = _await(lambda: client.call_async(request), node, client.service_is_ready,
                      client.srv_name, timeout_s, repeatable)
    if not response.success:
        raise Refused(response)
    return response


class ActionCaller:
    """Send goals to one action and wait for them."""

    def __init__(self, node: Node, action_type: MessageType, name: str) -> None:
        self._node = node
        self._name = name
        self._client = PatientActionClient(node, action_type, name)

    def run(self, goal: Message, on_feedback: Callable[[Message], object] | None = None,
            cancelled: Callable[[], bool] = lambda: False) -> Message:
        """Run one goal to its end; return its result, also that of a cancelled goal.

        `on_feedback` is called with each feedback message, in the executor's thread. An exception
        that it raises cancels the goal, and is raised here unless the work is cancelled anyway.
        `cancelled` is called periodically; True cancels the goal, whose end is still awaited.

        Raise GoalAborted if the goal ended without success, and CallFailed if there is no server,
        the goal was rejected, or the server's node or this one ends meanwhile.
        """
        _await_service(self._node, self._client.wait_for_server, self._name, CALL_TIMEOUT_S)
        set_deadline(goal, CALL_TIMEOUT_S)
        failures: list[Exception] = []

        def pass_on(message: Message) -> None:
            if on_feedback is None or failures:
                return
            try:
                on_feedback(message.feedback)
            except Exception as error:  # in the executor it would end the node
                failures.append(error)

        handle = self._await(lambda: self._client.send_goal_async(goal, pass_on),
                             CALL_TIMEOUT_S, self._late(self._client.settle))
        if not handle.accepted:
            raise CallFailed(f"{self._name} rejected the goal: its node is busy or not active, "
                             "its log states which")
        result = self._end(handle, lambda: bool(failures) or cancelled()).result
        if cancelled():
            return result
        if failures:
            raise failures[0]
        if not result.success:
            raise GoalAborted(result)
        return result

    def _late(self, work: Callable[[], object]) -> Callable[[], None]:
        """Return a function that, while a response is late, works in the executor now and then."""
        begin_s = time.monotonic()

        def look() -> None:
            nonlocal begin_s
            if time.monotonic() - begin_s > RESEND_S:
                begin_s = time.monotonic()
                self._in_executor(work)

        return look

    def _end(self, handle: ClientGoalHandle, cancelled: Callable[[], bool]) -> Message:
        waiting, asked_s = Waiting(self._node, self._name), math.inf
        ask_again = self._late(self._client.ask_again)

        def look() -> None:
            nonlocal asked_s
            ask_again()
            now_s = time.monotonic()
            if asked_s < now_s:
                waiting.look(now_s - asked_s)
            elif cancelled():
                asked_s = now_s
                self._in_executor(handle.cancel_goal_async)

        return self._await(handle.get_result_async, None, look)

    def _await(self, send: Callable[[], Future], timeout_s: float | None,
               look: Callable[[], None] = lambda: None) -> Any:
        """Send from the executor's thread, between two callbacks, and wait for the response.

        From another thread the response may come before rclpy has registered the request.
        """
        sent: queue.SimpleQueue[Future] = queue.SimpleQueue()
        self._in_executor(lambda: sent.put(send()))
        begin_s = time.monotonic()
        while sent.empty():
            _check_alive(self._node, self._name)
            if time.monotonic() - begin_s > CALL_TIMEOUT_S:
                raise CallFailed(f"{self._name} was not called within {CALL_TIMEOUT_S:g} s: this "
                                 "node hangs, start it again")
            time.sleep(POLL_S / 10)
        return _await(sent.get, self._node, self._client.server_is_ready, self._name, timeout_s,
                      look=look)

    def _in_executor(self, work: Callable[[], object]) -> None:
        executor = self._node.executor
        if executor is None:
            raise CallFailed(f"this node ended before {self._name} answered: start it again")
        executor.create_task(work)


def _await_service(node: Node, appears: Callable[[float], bool], name: str,
                   timeout_s: float) -> None:
    """Wait for the server of a name, and log while there is none."""
    waiting, begin_s, waited_s = Waiting(node, name), time.monotonic(), 0.0
    while not appears(min(timeout_s - waited_s, WORD_AFTER_S)):
        _check_alive(node, name)
        waited_s = time.monotonic() - begin_s
        if waited_s >= timeout_s:
            raise CallFailed(f"nobody serves {name}: start its node")
        waiting.look(waited_s)


def _await(send: Callable[[], Future], node: Node, is_served: Callable[[], bool], name: str,
           timeout_s: float | None, repeatable: bool = False,
           look: Callable[[], None] = lambda: None) -> Any:
    """Send, and return the first response; monitor the server while there is none.

    The result of a goal has no timeout and may take long; its progress is reported separately.
    """
    answers: queue.SimpleQueue[Future] = queue.SimpleQueue()
    waiting = Waiting(node, name)
    sent_s = begin_s = served_s = time.monotonic()
    resend_s = RESEND_S
    send().add_done_callback(answers.put)
    while True:
        try:
            return answers.get(timeout=POLL_S).result()
        except queue.Empty:
            now_s = time.monotonic()
        _check_alive(node, name)
        if _holds(is_served):
            served_s = now_s
        elif now_s - served_s > LAST_ANSWER_S:
            raise CallFailed(f"the node that serves {name} has ended: start it again")
        if timeout_s is not None:
            if now_s - begin_s > timeout_s:
                raise NoAnswer(f"{described_server(node, name)} did not answer {name} within "
                               f"{timeout_s:g} s: look at its log")
            waiting.look(now_s - begin_s)
        if repeatable and now_s - sent_s > resend_s:
            sent_s, resend_s = now_s, 2.0 * resend_s
            send().add_done_callback(answers.put)
        look()


def _check_alive(node: Node, name: str) -> None:
    if not node.context.ok():
        raise CallFailed(f"this node ended before {name} answered: start it again")


def _holds(is_served: Callable[[], bool]) -> bool:
    try:
        return is_served()
    except InvalidHandle:  # the node is being destroyed
        return False
