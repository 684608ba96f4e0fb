# SPDX-License-Identifier: BSD-3-Clause
"""Say which node is waited for."""

from contextlib import suppress

from rclpy.node import Node, NodeNameNonExistentError

WORD_AFTER_S = 5.0
"""So long a request waits without a word; then it says so each time that this has passed."""


class Waiting:
    """Log now and then for which node a request waits.

    Parameters
    ----------
    node : rclpy.node.Node
        That waits.
    service : str
        Name of the service or action that is asked.
    """

    def __init__(self, node: Node, service: str) -> None:
        self._node, self._service = node, service
        self._told = 0

    def look(self, waited_s: float) -> None:
        """Say so where another `WORD_AFTER_S` has passed."""
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
        That sees the others.
    service : str
        Its name, relative to the node's namespace or full.
    """
    full_name = node.resolve_service_name(service)
    names = {full_name, f"{full_name}/_action/send_goal"}
    for name, namespace in node.get_node_names_and_namespaces():
        with suppress(NodeNameNonExistentError):  # gone meanwhile
            if names & dict(node.get_service_names_and_types_by_node(name, namespace)).keys():
                return f"{namespace.rstrip('/')}/{name}"
    return ""
