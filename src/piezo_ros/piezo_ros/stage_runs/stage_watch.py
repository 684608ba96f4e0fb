# SPDX-License-Identifier: BSD-3-Clause
"""Determine whether the stage is there, and why it stopped."""

import threading
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from piezo_ros.presence import Presence
from piezo_ros.quality import DIAGNOSTICS_DEPTH

# The stage publishes its state every second, and later on a busy computer.
NEWS_TIMEOUT_S = 10.0
POLL_S = 0.05
ACTIVE = "active"
"""Key in the stage's diagnostics: whether it is active, True or False."""


class StageWatch:
    """Reports of the stage in a node's namespace during one run after the other."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._name = f"{node.get_namespace().rstrip('/')}/stage"
        self._news = threading.Event()
        self.begin()
        node.create_subscription(
            DiagnosticArray, "/diagnostics", self._on_diagnostics, DIAGNOSTICS_DEPTH)

    def begin(self) -> None:
        """Begin a run, and discard earlier reports."""
        self._stopped, self._active = "", True
        self._presence = Presence(self._node, self._name)

    @property
    def gone(self) -> bool:
        """Return True if the stage's node has disappeared since the run began."""
        return self._presence.gone

    @property
    def stopped(self) -> str:
        """Return the reported cause of a stop; empty without one."""
        return self._stopped

    def why_ended(self) -> str:
        """Return why a run ended early; wait for the stage's report if necessary."""
        self._news.clear()
        deadline_s = time.monotonic() + NEWS_TIMEOUT_S
        while not (self._stopped or self.gone or time.monotonic() > deadline_s):
            if self._news.wait(POLL_S):
                break
        if self._stopped:
            return self._stopped
        if self.gone:
            return f"the stage {self._name} is gone: start it again"
        if not self._active:
            return "it was deactivated"
        return "somebody else called stop_tracking"

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name != f"{self._name}: stage":
                continue
            self._active = KeyValue(key=ACTIVE, value=str(False)) not in status.values
            if status.level == DiagnosticStatus.ERROR:
                self._stopped = self._stopped or status.message
            self._news.set()
