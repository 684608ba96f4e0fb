# SPDX-License-Identifier: BSD-3-Clause
"""How late the ticks of a stage begin that keeps the pace of its backend's clock."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from piezo_stage_driver.engine.answer_latency import LatencyCounts

# By which the backend's clock may go slower than the computer's.
CLOCK_TOLERANCE = 5e-4
# A backend that is further behind may set its clock anew; it then waits again, though it is late.
LARGEST_LAG_S = 0.05


class TickTimes:
    """A backend that counts how late it is asked for each exchange.

    An exchange ends when its samples have been measured; the next one is due then. The clock's
    phase is that of the exchanges that returned soonest, so that a thread that was woken late
    counts as late. A tick misses its deadline where it is asked for later than the hardware can
    wait: by `lead_samples`, or by a tick where nothing is written ahead. A backend that sets its
    clock anew after a long pause has the phase from there on.

    Parameters
    ----------
    backend : StageBackend
        What is driven; its other attributes are passed on.
    clock : callable
        Returns the time (s).

    Attributes
    ----------
    missed : int
        Exchanges since `open` that missed their deadline.
    lateness : LatencyCounts
        From the moment at which an exchange was due until it was asked for.
    """

    _due_s: float | None

    def __init__(self, backend: Any, clock: Callable[[], float] = time.monotonic) -> None:
        self._backend, self._clock = backend, clock
        self._begin()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._backend, name)

    def open(self) -> None:
        """Open the backend; see ``StageBackend.open``."""
        self._begin()
        self._backend.open()

    def exchange(self, voltage_v: np.ndarray) -> np.ndarray:
        """Play samples; see ``StageBackend.exchange``."""
        duration_s = len(voltage_v) / self._backend.sample_rate_hz
        asked_s = self._clock()
        try:
            displacement_um: np.ndarray = self._backend.exchange(voltage_v)
        except Exception:
            if self._due_s is not None:
                self._count(asked_s - self._due_s, duration_s)
            raise
        returned_s = self._clock()
        if self._due_s is not None:
            if asked_s - self._due_s > LARGEST_LAG_S and returned_s - asked_s > 0.5 * duration_s:
                self._due_s = returned_s - duration_s
            self._count(asked_s - self._due_s, duration_s)
        latest_s = returned_s if self._due_s is None else (
            self._due_s + (1.0 + CLOCK_TOLERANCE) * duration_s)
        self._due_s = min(returned_s, latest_s)
        return displacement_um

    @property
    def ticks(self) -> int:
        """Return how many exchanges are counted."""
        return sum(self.lateness.counts)

    def described(self) -> dict[str, object]:
        """Return the counts under names, as in ``ticks_within_0.5_ms``."""
        return {"missed_deadlines": self.missed,
                **self.lateness.described("ticks", "longest_wait_of_a_tick_ms")}

    def _begin(self) -> None:
        self.missed = 0
        self.lateness = LatencyCounts()
        self._due_s = None

    def _count(self, late_s: float, duration_s: float) -> None:
        lead_s = getattr(self._backend, "lead_samples", 0) / self._backend.sample_rate_hz
        self.missed += late_s > max(lead_s, duration_s)
        self.lateness.add(1e3 * late_s)
