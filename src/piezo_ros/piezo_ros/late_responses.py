# SPDX-License-Identifier: BSD-3-Clause
"""Services that respond later than they are called, or refuse what they would fail to do."""

import threading
import time
from collections.abc import Callable

from lifecycle_msgs.srv import ChangeState
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.service import Service

from piezo_ros.deadlines import seconds_since, why_too_late
from piezo_ros.messages import Message, MessageType

RCLError = rclpy_implementation.RCLError


class LateResponse:
    """The response of one call; `give` sends it once, from any thread.

    A coroutine could do the same, but the executor of this rclpy polls a waiting one continuously.
    Attribute `asked_s` is the time at which the client sent its request, by the monotonic clock in
    s.
    """

    def __init__(self, node: Node, response: Message) -> None:
        self.response = response
        self.asked_s = time.monotonic()
        self._node = node
        self._lock = threading.Lock()
        self._given = False
        self._send: Callable[[Message], None] | None = None
        self._sharers: list[LateResponse] = []

    def give(self) -> None:
        """Send the response, unless it has been sent."""
        with self._lock:
            given, self._given = self._given, True
            send, sharers = self._send, self._sharers
        if given:
            return
        executor = self._node.executor
        if send and executor is not None:  # otherwise the node has ended
            executor.create_task(send, self.response)
        for other in sharers:
            other.response = self.response
            other.give()

    def share(self, other: "LateResponse") -> None:
        """Give the same response to another call, as soon as it is available."""
        with self._lock:
            given = self._given
            if not given:
                self._sharers.append(other)
        if given:
            other.response = self.response
            other.give()

    def send_by(self, send: Callable[[Message], None]) -> None:
        """Set the function that sends; called once the service's callback has returned."""
        with self._lock:
            self._send, given = send, self._given
        if given:
            send(self.response)


def create_late_service(node: Node, service_type: MessageType, name: str,
                        callback: Callable[[Message, LateResponse], object],
                        acts_late: bool = False) -> Service:
    """Create a service whose callback may respond after it returns.

    The callback is called as ``callback(request, late)`` with a `LateResponse`, whose `give` must
    be called. The response must have ``success`` and ``message``. A request that comes too late is
    rejected and logged, unless the callback acts late: it then decides itself.
    """
    service = node.create_service(
        service_type, name, lambda request, response: (request, LateResponse(node, response)))
    send_response = service.send_response

    def begin(call: tuple[Message, LateResponse], header: Message) -> None:
        (request, late), age_s = call, seconds_since(header.source_timestamp)
        late.asked_s -= age_s
        if not acts_late and (reason := why_too_late(request, age_s)):
            late.response.success, late.response.message = False, f"{name} refused: {reason}"
            node.get_logger().warning(late.response.message)
            late.give()
        else:
            callback(request, late)
        late.send_by(lambda response: send_response(response, header))

    # The executor treats the return value of the callback as the response, and passes it here with
    # the header, which contains the time of the request.
    service.send_response = begin  # type: ignore[method-assign, assignment]
    return service


def answer_impossible_transitions(node: Node) -> None:
    """Make a node respond to an impossible ``change_state`` with false, and log the reason.

    rclpy raises an error in the executor instead, which ends the node without a response. A request
    that comes too late is rejected as well, as its client may have given it up. A node without a
    lifecycle is not changed.
    """
    for service in node.services:
        if service.srv_type is ChangeState:
            _answer_all(node, service)


def _answer_all(node: Node, service: Service) -> None:
    change_state, send_response = service.callback, service.send_response

    def answer(call: tuple[ChangeState.Request, ChangeState.Response], header: Message) -> None:
        request, response = call
        reason = why_too_late(request, seconds_since(header.source_timestamp))
        try:
            if not reason:
                response = change_state(request, response)
        except RCLError:
            reason = ("it does not lead on from the present state; "
                      "ask get_available_transitions which do")
        if reason:
            wanted = request.transition.label or request.transition.id
            node.get_logger().warning(f"transition {wanted} refused: {reason}")
            response.success = False
        send_response(response, header)

    # As in `create_late_service`.
    service.callback = lambda *call: call  # type: ignore[assignment, return-value]
    service.send_response = answer  # type: ignore[method-assign, assignment]
