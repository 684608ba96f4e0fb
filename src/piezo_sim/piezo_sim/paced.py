# SPDX-License-Identifier: BSD-3-Clause
"""Run a simulated stage in real time."""

import time
from typing import Any

from piezo_common.arrays import FloatArray

# Largest delay in s that is caught up with; after a larger one the clock is reset.
LARGEST_LAG_S = 0.1


class PacedStage:
    """A backend whose exchanges take as long as their samples."""

    def __init__(self, backend: Any) -> None:
        self._backend = backend
        self._due_s = 0.0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._backend, name)

    def open(self) -> None:
        """Start the backend and the clock."""
        self._backend.open()
        self._due_s = time.monotonic()

    def exchange(self, voltage_v: FloatArray) -> FloatArray:
        """Play voltages in real time; see ``StageBackend.exchange``."""
        displacement_um = self._backend.exchange(voltage_v)
        self._due_s += len(voltage_v) / self._backend.sample_rate_hz
        wait_s = self._due_s - time.monotonic()
        if wait_s > 0.0:
            time.sleep(wait_s)
        elif wait_s < -LARGEST_LAG_S:
            self._due_s = time.monotonic()
        return displacement_um
