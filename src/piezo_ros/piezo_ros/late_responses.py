# SPDX-License-Identifier: BSD-3-Clause
"""Services that respond later than they are called, without blocking the executor."""

import threading
import time
from collections.abc import Callable

from rclpy.node import Node
from rclpy.service import Service

from piezo_ros.deadlines import seconds_since, why_too_late
from piezo_ros.messages import Message, MessageType


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
