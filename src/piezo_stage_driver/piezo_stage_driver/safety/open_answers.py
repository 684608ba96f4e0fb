# SPDX-License-Identifier: BSD-3-Clause
"""Count of the answers that clients still wait for."""

import threading


class OpenAnswers:
    """Count answers that have begun and not yet ended; safe to use from any thread."""

    def __init__(self) -> None:
        self._open = 0
        self._lock = threading.Lock()

    @property
    def none(self) -> bool:
        """Return whether every answer that has begun was given."""
        return self._open == 0

    def begin(self) -> None:
        """Count an answer that has begun."""
        self._count(1)

    def end(self) -> None:
        """Count an answer that was given."""
        self._count(-1)

    def _count(self, change: int) -> None:
        with self._lock:
            self._open = self._open + change
