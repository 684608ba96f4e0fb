# SPDX-License-Identifier: BSD-3-Clause
"""Notice that this process stood still, as after Ctrl-Z."""

import math
import signal
import threading
import time
from types import FrameType

PERIOD_S = 0.2
# Shorter gaps are those of a busy computer.
SHORTEST_GAP_S = 2 * PERIOD_S
# How much later than it goes on a process may be told that it does, or notice the gap.
SIGNAL_DELAY_S = 2.0


class Heartbeat:
    """Tell how long the whole process stood still; one that is merely busy does not count.

    A thread that beats notices the gap, and the signal SIGCONT tells that it was a standstill. Long
    calls that keep Python to themselves make gaps, too, but the middleware works on meanwhile.
    Only the main thread can listen to the signal: made elsewhere, a heartbeat goes by gaps alone.
    """

    def __init__(self) -> None:
        self._ended = threading.Event()
        self._gap_s, self._gap_ended_s = 0.0, -math.inf
        self._continued_s, self._standstill_s = -math.inf, 0.0
        self._hears_signals = threading.current_thread() is threading.main_thread()
        if self._hears_signals:
            self._others = signal.signal(signal.SIGCONT, self._go_on)
        threading.Thread(target=self._beat, name="heartbeat", daemon=True).start()

    def standstill_s(self) -> float:
        """Return how long the process stood still since this was asked last (s)."""
        standstill_s, self._standstill_s = self._standstill_s, 0.0
        return standstill_s

    def end(self) -> None:
        """Let the thread end."""
        self._ended.set()

    def _go_on(self, number: int, frame: FrameType | None) -> None:
        self._continued_s = time.monotonic()
        self._compare()
        if callable(self._others):
            self._others(number, frame)

    def _beat(self) -> None:
        last_s = time.monotonic()
        while not self._ended.wait(PERIOD_S):
            now_s = time.monotonic()
            gap_s, last_s = now_s - last_s, now_s
            forgotten = now_s - self._gap_ended_s > SIGNAL_DELAY_S
            if gap_s > (SHORTEST_GAP_S if forgotten else max(self._gap_s, SHORTEST_GAP_S)):
                self._gap_ended_s, self._gap_s = now_s, gap_s
                self._compare()

    def _compare(self) -> None:
        """Take the gap for a standstill if it ended about when the process was told to go on."""
        apart_s = abs(self._gap_ended_s - self._continued_s)
        if not self._hears_signals or apart_s < SIGNAL_DELAY_S:
            self._standstill_s = max(self._standstill_s, self._gap_s)
            self._gap_s = 0.0
