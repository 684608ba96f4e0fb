# SPDX-License-Identifier: BSD-3-Clause
"""Detect that a node is gone, for whatever reason."""

import time

from rclpy.node import Node

# Largest time in s from the start of a node to its discovery.
APPEARANCE_TIMEOUT_S = 10.0
# Publishers found within this time in s belong to the node, not to a successor with its name.
SETTLING_S = 1.0
LOOK_PERIOD_S = 0.1
# Every node publishes it, in any language.
COMMON_TOPIC = "/parameter_events"


class Presence:
    """Determine whether a node, given by its full name, is gone; without a name, it never is.

    A node that was killed and one that was restarted under its name are distinguished by the
    identities of their publishers in the middleware: the second does not count as the first.
    """

    def __init__(self, node: Node, name: str) -> None:
        self._node = node
        self.name = name
        self._identities: set[bytes] = set()
        self._seen = False
        self._since_s = self._looked_s = time.monotonic()
        # Look now: if the next look is late, a successor may already be there by then.
        self._gone = bool(name) and self._look(0.0)

    @property
    def gone(self) -> bool:
        """Return True if the node was seen and has disappeared; this never changes back.

        A node that was never seen counts as gone after a while.
        """
        now_s = time.monotonic()
        if self.name and not self._gone and now_s - self._looked_s >= LOOK_PERIOD_S:
            self._looked_s = now_s
            self._gone = self._look(now_s - self._since_s)
        return self._gone

    def _look(self, watched_s: float) -> bool:
        identities = _identities(self._node, self.name)
        # The graph may tell the name of a node long before its publishers.
        if watched_s < SETTLING_S or not self._identities:
            self._identities |= identities
        present = self.name in _full_names(self._node)
        if self._identities:
            present = not self._identities.isdisjoint(identities)
        self._seen = self._seen or present
        return not present and (self._seen or watched_s > APPEARANCE_TIMEOUT_S)


class ClientWatch:
    """Determine whether the present client of a node is gone."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._presence = Presence(node, "")

    def is_gone(self, client: str) -> bool:
        """Return True if a node, given by its full name, was seen and has disappeared.

        Call it with an empty name while there is no client: a later client with the name of an
        earlier one is then watched anew.
        """
        if client != self._presence.name:
            self._presence = Presence(self._node, client)
        return self._presence.gone


def _identities(node: Node, name: str) -> set[bytes]:
    return {bytes(publisher.endpoint_gid)
            for publisher in node.get_publishers_info_by_topic(COMMON_TOPIC)
            if _full_name(publisher.node_name, publisher.node_namespace) == name}


def _full_names(node: Node) -> set[str]:
    return {_full_name(*found) for found in node.get_node_names_and_namespaces()}


def _full_name(name: str, namespace: str) -> str:
    return f"{namespace.rstrip('/')}/{name}"
