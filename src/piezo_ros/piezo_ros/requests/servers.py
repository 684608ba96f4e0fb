# SPDX-License-Identifier: BSD-3-Clause
"""Log which node a request waits for."""

from contextlib import suppress

from rclpy.node import Node, NodeNameNonExistentError

WORD_AFTER_S = 5.0
"""Time in s without a response after which a request logs that it waits, repeatedly."""


class Waiting:
    """Log periodically which node a request waits for.

    Parameters
    ----------
    node : rclpy.node.Node
        Node that waits.
    service : str
        Name of the service or action.
    """

    def __init__(self, node: Node, service: str) -> None:
        self._node, self._service = node, service
        self._told = 0

    def look(self, waited_s: float) -> None:
        """Log the wait if another `WORD_AFTER_S` has passed."""
        due = int(waited_s / WORD_AFTER_S)
        if due <= self._told:
            return
        self._told = due
        server = server_of(self._node, self._service)
        self._node.get_logger().warning(
            f"{server} has not answered {self._service} for {waited_s:.0f} s: waiting" if server
            else f"nobody has served {self._service} for {waited_s:.0f} s: waiting for its node")


def server_of(node: Node, service: str) -> str:
    """Return the full name of the node that serves a service or an action; empty if none does.

    Parameters
    ----------
    node : rclpy.node.Node
        Node that looks for it.
    service : str
        Name of the service or action, relative to the node's namespace or full.
    """
    full_name = node.resolve_service_name(service)
    names = {full_name, f"{full_name}/_action/send_goal"}
    for name, namespace in node.get_node_names_and_namespaces():
        with suppress(NodeNameNonExistentError):  # gone meanwhile
            if names & dict(node.get_service_names_and_types_by_node(name, namespace)).keys():
                return f"{namespace.rstrip('/')}/{name}"
    return ""
