# SPDX-License-Identifier: BSD-3-Clause
"""Services that are answered later than they are called, while the executor goes on."""

import threading
from collections.abc import Callable

from rclpy.node import Node
from rclpy.service import Service

from piezo_ros.deadlines import why_too_late
from piezo_ros.messages import Message, MessageType


class LateResponse:
    """The response of one call; `give` sends it, from any thread, once.

    A coroutine would do the same, but the executor of this rclpy polls one that waits, busily.

    Parameters
    ----------
    response : message
        To be filled in.
    """

    def __init__(self, node: Node, response: Message) -> None:
        self.response = response
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
                        callback: Callable[[Message, LateResponse], object]) -> Service:
    """Create a service whose callback need not answer before it returns.

    A request whose deadline has passed is refused, and logged; its response has ``success`` and
    ``message``.

    Parameters
    ----------
    callback : callable
        ``callback(request, late)`` with a `LateResponse`, which somebody gives in the end.
    """
    def begin(request: Message, response: Message) -> LateResponse:
        late = LateResponse(node, response)
        if reason := why_too_late(request):
            response.success, response.message = False, f"{name} refused: {reason}"
            node.get_logger().warning(response.message)
            late.give()
        else:
            callback(request, late)
        return late

    service = node.create_service(service_type, name, begin)
    send_response = service.send_response

    def send_later(late: LateResponse, header: Message) -> None:
        late.send_by(lambda response: send_response(response, header))

    # The executor passes on what the callback returns as if it were the response.
    service.send_response = send_later  # type: ignore[method-assign, assignment]
    return service
