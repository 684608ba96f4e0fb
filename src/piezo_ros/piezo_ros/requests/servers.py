# SPDX-License-Identifier: BSD-3-Clause
"""Log which node a request waits for."""

from contextlib import suppress

from rclpy.node import Node, NodeNameNonExistentError

WORD_AFTER_S = 5.0
"""Time in s without a response after which a request logs that it waits, repeatedly."""


class Waiting:
    """Log periodically which node a request waits for, by the name of its service or action."""

    def __init__(self, node: Node, service: str) -> None:
        self._node, self._service = node, service
        self._reported = 0

    def look(self, waited_s: float) -> None:
        """Log the wait if another `WORD_AFTER_S` has passed."""
        due = int(waited_s / WORD_AFTER_S)
        if due <= self._reported:
            return
        self._reported = due
        self._node.get_logger().warning(
            f"{described_server(self._node, self._service)} has not answered {self._service} for "
            f"{waited_s:.0f} s: waiting" if _is_served(self._node, self._service)
            else f"nobody has served {self._service} for {waited_s:.0f} s: waiting for its node")


def described_server(node: Node, service: str) -> str:
    """Return `server_of` a service or an action, or a description of it.

    The middleware forgets the name of a node that it once took for dead, but not its services.
    """
    return server_of(node, service) or f"the node that serves {service}"


def server_of(node: Node, service: str) -> str:
    """Return the full name of the node that serves a service or an action; empty if unknown.

    The name of the service is full, or relative to the node's namespace.
    """
    names = _names(node, service)
    for name, namespace in node.get_node_names_and_namespaces():
        with suppress(NodeNameNonExistentError):  # gone meanwhile
            if names & dict(node.get_service_names_and_types_by_node(name, namespace)).keys():
                return f"{namespace.rstrip('/')}/{name}"
    return ""


def _is_served(node: Node, service: str) -> bool:
    return any(node.count_services(name) for name in _names(node, service))


def _names(node: Node, service: str) -> set[str]:
    full_name = node.resolve_service_name(service)
    return {full_name, f"{full_name}/_action/send_goal"}
