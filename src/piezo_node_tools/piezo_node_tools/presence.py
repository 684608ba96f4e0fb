# SPDX-License-Identifier: BSD-3-Clause
"""Notice that a node is gone, however it went."""

import time

# What a node that has just started may take to be seen.
APPEARANCE_TIMEOUT_S = 10.0


class ClientWatch:
    """Tell whether the node that one works for is gone.

    Parameters
    ----------
    node : rclpy.node.Node
        That watches.
    """

    def __init__(self, node):
        self._node = node
        self._client = ""
        self._seen = False
        self._since_s = 0.0

    def is_gone(self, client):
        """Whether a node, given by its full name, has been there and is not any more.

        One that was never seen counts as gone after a while.
        """
        if client != self._client:
            self._client, self._seen, self._since_s = client, False, time.monotonic()
        present = client in _full_names(self._node)
        self._seen = self._seen or present
        waited_s = time.monotonic() - self._since_s
        return not present and (self._seen or waited_s > APPEARANCE_TIMEOUT_S)


def _full_names(node):
    return {f"{namespace.rstrip('/')}/{name}"
            for name, namespace in node.get_node_names_and_namespaces()}
