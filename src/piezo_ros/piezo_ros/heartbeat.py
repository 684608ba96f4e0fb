# SPDX-License-Identifier: BSD-3-Clause
"""Notice that this process stood still, as after Ctrl-Z."""

import threading
import time

PERIOD_S = 0.2


class Heartbeat:
    """Tell how long the whole process stood still; a thread that is merely busy does not count.

    A thread of its own beats. It stops with the process only, as the threads of the middleware do
    that give others the signs of life.
    """

    def __init__(self) -> None:
        self._ended = threading.Event()
        self._longest_s = 0.0
        threading.Thread(target=self._beat, name="heartbeat", daemon=True).start()

    def standstill_s(self) -> float:
        """Return the longest standstill since this was asked last (s)."""
        longest_s, self._longest_s = self._longest_s, 0.0
        return longest_s

    def end(self) -> None:
        """Let the thread end."""
        self._ended.set()

    def _beat(self) -> None:
        last_s = time.monotonic()
        while not self._ended.wait(PERIOD_S):
            now_s = time.monotonic()
            self._longest_s = max(self._longest_s, now_s - last_s - PERIOD_S)
            last_s = now_s
