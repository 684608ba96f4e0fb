# SPDX-License-Identifier: BSD-3-Clause
"""Services whose callbacks wait for something before they answer."""

import inspect
from collections.abc import Callable, Coroutine
from typing import Any

from rclpy.node import Node


def create_waiting_service(
        node: Node, service_type: type, name: str,
        callback: Callable[[Any, Any], Coroutine[None, None, Any]]) -> None:
    """Create a service whose callback is a coroutine.

    The events executor does not await it but passes it on as if it were the response.

    Parameters
    ----------
    node : rclpy.node.Node
    service_type : type
    name : str
    callback : coroutine function
        Takes request and response, returns the response.
    """
    service = node.create_service(service_type, name, callback)
    send_response = service.send_response

    def answer(response: Any, header: Any) -> None:
        if not inspect.iscoroutine(response):
            send_response(response, header)
            return

        async def answer_later() -> None:
            send_response(await response, header)

        executor = node.executor
        if executor is not None:  # else the node has ended without waiting any longer
            executor.create_task(answer_later)

    service.send_response = answer  # type: ignore[method-assign]
