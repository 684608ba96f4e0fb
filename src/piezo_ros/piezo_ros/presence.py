# SPDX-License-Identifier: BSD-3-Clause
"""Notice that a node is gone, however it went."""

import time

from rclpy.node import Node

# What a node that has just started may take to be seen.
APPEARANCE_TIMEOUT_S = 10.0
# What is found of a node so soon belongs to the one that is meant, not to a successor of its name.
SETTLING_S = 1.0
LOOK_PERIOD_S = 0.1
# Every node publishes it, whatever it is written in.
COMMON_TOPIC = "/parameter_events"


class Presence:
    """Tell whether a node that one relies on is gone.

    A node that was killed and one that was started again under its name are told apart by
    what the middleware calls their publishers: the second does not stand for the first.

    Parameters
    ----------
    node : rclpy.node.Node
        That watches.
    name : str
        Full name of the node that is watched; with an empty one nobody ever is gone.
    """

    def __init__(self, node: Node, name: str) -> None:
        self._node = node
        self.name = name
        self._identities: set[bytes] = set()
        self._seen = False
        self._since_s = self._looked_s = time.monotonic()
        # At once: where nobody gets round to it for long, a successor may be there by then.
        self._gone = bool(name) and self._look(0.0)

    @property
    def gone(self) -> bool:
        """Tell whether the node has been there and is not any more; one that is gone stays so.

        One that was never seen counts as gone after a while.
        """
        now_s = time.monotonic()
        if self.name and not self._gone and now_s - self._looked_s >= LOOK_PERIOD_S:
            self._looked_s = now_s
            self._gone = self._look(now_s - self._since_s)
        return self._gone

    def _look(self, watched_s: float) -> bool:
        identities = _identities(self._node, self.name)
        if watched_s < SETTLING_S or not self._seen:
            self._identities |= identities
        present = self.name in _full_names(self._node)
        if self._identities:
            present = not self._identities.isdisjoint(identities)
        self._seen = self._seen or present
        return not present and (self._seen or watched_s > APPEARANCE_TIMEOUT_S)


class ClientWatch:
    """Tell whether the node that one works for at present is gone.

    Parameters
    ----------
    node : rclpy.node.Node
        That watches.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._presence = Presence(node, "")

    def is_gone(self, client: str) -> bool:
        """Tell whether a node, given by its full name, has been there and is not any more.

        Ask with an empty name while there is none: a client that comes later under the name of
        one before is then looked at anew.
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
