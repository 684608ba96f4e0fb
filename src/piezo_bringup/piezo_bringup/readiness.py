# SPDX-License-Identifier: BSD-3-Clause
"""Detect when started nodes respond."""

import time
from collections.abc import Iterable
from typing import Self

import rclpy
from rcl_interfaces.srv import GetParameters
from rclpy.task import Future

from piezo_ros.discovery import prepare_discovery
from piezo_ros.executor import make_executor, spin_once
from piezo_ros.leaving import leave

ASK_AGAIN_S = 2.0
"""A node may respond before discovery of the caller is complete; that response is lost."""


class Readiness:
    """A node that checks whether others respond; a context manager.

    Every node has a parameter service, which responds once the node spins, after its set-up.

    Raises
    ------
    RuntimeError
        If ROS cannot be initialised, for example because its security has no enclave for this node.
    """

    def __init__(self, names: Iterable[str], namespace: str = "") -> None:
        prepare_discovery()
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self._node = rclpy.create_node("client_of_suite", namespace=namespace,
                                       context=self._context)
        self._executor = make_executor(self._context)
        self._executor.add_node(self._node)
        self._servers = {
            name: self._node.create_client(GetParameters, f"{name}/get_parameters")
            for name in names}
        self._asked: dict[str, tuple[float, list[Future]]] = {}
        self._silent = set(self._servers)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.remove_node(self._node)
        self._executor.shutdown()
        for server in self._servers.values():
            self._node.destroy_client(server)
        leave(self._node)

    def look(self, timeout_s: float) -> set[str]:
        """Query nodes that have not responded until the timeout; return those still silent."""
        for name in self._silent:
            self._ask(name)
        until_s = time.monotonic() + timeout_s
        while self._silent and (left_s := until_s - time.monotonic()) > 0.0:
            spin_once(self._executor, left_s)
            self._silent -= {name for name, (_, answers) in self._asked.items()
                             if any(answer.done() for answer in answers)}
        return set(self._silent)

    def _ask(self, name: str) -> None:
        server, now_s = self._servers[name], time.monotonic()
        asked_s, answers = self._asked.get(name, (-ASK_AGAIN_S, []))
        if server.service_is_ready() and now_s - asked_s >= ASK_AGAIN_S:
            self._asked[name] = now_s, [*answers, server.call_async(GetParameters.Request())]
