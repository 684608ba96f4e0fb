# SPDX-License-Identifier: BSD-3-Clause
"""Services whose callbacks wait before they answer."""

from collections.abc import Callable, Coroutine
from typing import Any

from rclpy.node import Node

from piezo_ros.late_responses import LateResponse, create_late_service


def create_waiting_service(
        node: Node, service_type: type, name: str,
        callback: Callable[[Any, Any], Coroutine[None, None, Any]]) -> None:
    """Create a service whose callback is a coroutine.

    Parameters
    ----------
    callback : coroutine function
        Takes request and response, returns the response.
    """
    def begin(request: Any, late: LateResponse) -> None:
        async def answer() -> None:
            late.response = await callback(request, late.response)
            late.give()

        executor = node.executor
        if executor is not None:  # otherwise the node has ended without waiting any longer
            executor.create_task(answer)

    create_late_service(node, service_type, name, begin)
