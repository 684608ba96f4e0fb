# SPDX-License-Identifier: BSD-3-Clause
"""Notice that this process stood still, as after Ctrl-Z."""

import signal
import threading
import time
from types import FrameType

PERIOD_S = 0.2
# How much later than it goes on a process may be told that it does.
SIGNAL_DELAY_S = 2.0


class Heartbeat:
    """Tell how long the whole process stood still; one that is merely busy does not count.

    A thread that beats notices the gap, and the signal SIGCONT tells that it was a standstill. Long
    calls that keep Python to themselves make gaps, too, but the middleware works on meanwhile.
    Only the main thread can listen to the signal: made elsewhere, a heartbeat goes by gaps alone.
    """

    def __init__(self) -> None:
        self._ended = threading.Event()
        self._longest_s, self._continued_at_s = 0.0, -SIGNAL_DELAY_S
        self._hears_signals = threading.current_thread() is threading.main_thread()
        if self._hears_signals:
            self._others = signal.signal(signal.SIGCONT, self._go_on)
        threading.Thread(target=self._beat, name="heartbeat", daemon=True).start()

    def standstill_s(self) -> float:
        """Return how long the process stood still since this was asked last (s)."""
        told = time.monotonic() - self._continued_at_s < SIGNAL_DELAY_S
        if self._hears_signals and not told:
            self._longest_s = 0.0
            return 0.0
        longest_s, self._longest_s = self._longest_s, 0.0
        return longest_s

    def end(self) -> None:
        """Let the thread end."""
        self._ended.set()

    def _go_on(self, number: int, frame: FrameType | None) -> None:
        self._continued_at_s = time.monotonic()
        if callable(self._others):
            self._others(number, frame)

    def _beat(self) -> None:
        last_s = time.monotonic()
        while not self._ended.wait(PERIOD_S):
            now_s = time.monotonic()
            self._longest_s = max(self._longest_s, now_s - last_s - PERIOD_S)
            last_s = now_s
