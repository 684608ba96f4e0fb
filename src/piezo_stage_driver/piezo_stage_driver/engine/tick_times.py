# SPDX-License-Identifier: BSD-3-Clause
"""Delays of the ticks of a stage that is paced by its backend's clock."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from piezo_stage_driver.engine.answer_latency import LatencyCounts

# Largest relative deviation of the backend's clock from the computer's.
CLOCK_TOLERANCE = 5e-4
# A backend that lags more may restart its clock, and then waits again although it is late.
LARGEST_LAG_S = 0.05


class TickTimes:
    """A wrapper of a backend that measures the delay of each exchange.

    An exchange ends when its samples have been measured; the next one is due then. The phase of the
    clock is that of the earliest returns, so that a thread that was woken late counts as late. A
    tick misses its deadline if it is requested later than the hardware can wait: by `lead_samples`,
    or by a tick if nothing is written ahead. If a backend restarts its clock after a long pause,
    the phase is determined anew.

    `missed` is the number of exchanges since `open` that missed their deadline. `lateness` counts
    the delays from the time at which an exchange was due to the request.
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
        """Return the number of exchanges."""
        return sum(self.lateness.counts)

    def described(self) -> dict[str, object]:
        """Return the counts with names such as ``ticks_within_0.5_ms``."""
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
