# SPDX-License-Identifier: BSD-3-Clause
"""Detect that this process was suspended, for example by Ctrl-Z."""

import math
import signal
import threading
import time
from types import FrameType

PERIOD_S = 0.2
# Shorter gaps also occur on a busy computer.
SHORTEST_GAP_S = 2 * PERIOD_S
# Largest delay of the signal SIGCONT, or of noticing the gap, after the process continues.
SIGNAL_DELAY_S = 2.0


class Heartbeat:
    """Measure how long the whole process was suspended; a process that is only busy does not count.

    A periodic thread detects the gap, and the signal SIGCONT confirms that the process was
    suspended. Long calls that hold Python's lock cause gaps, too, but the middleware keeps working
    meanwhile. Only the main thread can receive the signal: created elsewhere, a heartbeat uses gaps
    alone.
    """

    def __init__(self) -> None:
        self._ended = threading.Event()
        self._gap_s, self._gap_ended_s = 0.0, -math.inf
        self._continued_s, self._standstill_s = -math.inf, 0.0
        self._hears_signals = threading.current_thread() is threading.main_thread()
        self._lock = threading.Lock()
        if self._hears_signals:
            self._others = signal.signal(signal.SIGCONT, self._go_on)
        # A suspension before the thread runs counts as well.
        threading.Thread(target=self._beat, args=(time.monotonic(),), name="heartbeat",
                         daemon=True).start()

    def standstill_s(self) -> float:
        """Return how long the process was suspended since the last call in s."""
        with self._lock:
            self._compare()
            standstill_s, self._standstill_s = self._standstill_s, 0.0
        return standstill_s

    def end(self) -> None:
        """End the thread."""
        self._ended.set()

    def _go_on(self, number: int, frame: FrameType | None) -> None:
        # A handler must not wait for the lock: it may have interrupted the thread that holds it.
        self._continued_s = time.monotonic()
        if callable(self._others):
            self._others(number, frame)

    def _beat(self, last_s: float) -> None:
        while not self._ended.wait(PERIOD_S):
            now_s = time.monotonic()
            gap_s, last_s = now_s - last_s, now_s
            with self._lock:
                forgotten = now_s - self._gap_ended_s > SIGNAL_DELAY_S
                if gap_s > (SHORTEST_GAP_S if forgotten else max(self._gap_s, SHORTEST_GAP_S)):
                    self._gap_ended_s, self._gap_s = now_s, gap_s
                self._compare()

    def _compare(self) -> None:
        """Count the gap as a suspension if it ended at about the time of SIGCONT."""
        apart_s = abs(self._gap_ended_s - self._continued_s)
        if self._gap_s and (not self._hears_signals or apart_s < SIGNAL_DELAY_S):
            self._standstill_s = max(self._standstill_s, self._gap_s)
            self._gap_s = 0.0
