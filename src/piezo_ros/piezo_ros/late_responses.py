# SPDX-License-Identifier: BSD-3-Clause
"""Services that are answered later than they are called, while the executor goes on."""

import threading
import time
from collections.abc import Callable

from rclpy.node import Node
from rclpy.service import Service

from piezo_ros.deadlines import seconds_since, why_too_late
from piezo_ros.messages import Message, MessageType


class LateResponse:
    """The response of one call; `give` sends it, from any thread, once.

    A coroutine would do the same, but the executor of this rclpy polls one that waits, busily.

    Parameters
    ----------
    response : message
        To be filled in.

    Attributes
    ----------
    asked_s : float
        When the client sent its request, by the monotonic clock (s).
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
        """Send the response, unless that is done."""
        with self._lock:
            given, self._given = self._given, True
            send, sharers = self._send, self._sharers
        if given:
            return
        executor = self._node.executor
        if send and executor is not None:  # else the node has ended, and nobody waits any more
            executor.create_task(send, self.response)
        for other in sharers:
            other.response = self.response
            other.give()

    def share(self, other: "LateResponse") -> None:
        """Give the same response to another call, as soon as it is there."""
        with self._lock:
            given = self._given
            if not given:
                self._sharers.append(other)
        if given:
            other.response = self.response
            other.give()

    def send_by(self, send: Callable[[Message], None]) -> None:
        """Take what sends; called once the service's callback has returned."""
        with self._lock:
            self._send, given = send, self._given
        if given:
            send(self.response)


def create_late_service(node: Node, service_type: MessageType, name: str,
                        callback: Callable[[Message, LateResponse], object],
                        acts_late: bool = False) -> Service:
    """Create a service whose callback need not answer before it returns.

    A request that comes too late is refused, and logged; its response has ``success`` and
    ``message``.

    Parameters
    ----------
    callback : callable
        ``callback(request, late)`` with a `LateResponse`, which somebody gives in the end.
    acts_late : bool
        Leave it to the callback what becomes of a request that comes too late.
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

    # The executor passes on what the callback returns as if it were the response, with the header
    # that says when the request was sent.
    service.send_response = begin  # type: ignore[method-assign, assignment]
    return service
