# SPDX-License-Identifier: BSD-3-Clause
"""A data acquisition card that breaks down, or hangs."""

import time
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from piezo_sim.effect import Surroundings, parameter, require
from piezo_sim.faults.window import FaultWindow, require_window
from piezo_stage_driver.backend import BackendFault


@dataclass(frozen=True)
class DeviceFailure:
    """No samples are exchanged any more."""

    name: ClassVar[str] = "device_failure"

    begin_s: float = parameter("s")
    end_s: float = parameter("s")

    def __post_init__(self):
        require_window(self)

    def start(self, surroundings: Surroundings) -> "DeviceFailureRunner":
        """Wait for the beginning."""
        return DeviceFailureRunner(self, surroundings)


class DeviceFailureRunner(FaultWindow):
    """Refuses to go on."""

    def spoil(self, samples: np.ndarray, first: int, last: int) -> None:
        """Raise the fault."""
        raise BackendFault("the simulated device failed: the samples were lost")


@dataclass(frozen=True)
class DeviceHang:
    """The device does not return for a while, once; then it goes on."""

    name: ClassVar[str] = "device_hang"

    begin_s: float = parameter("s")
    end_s: float = parameter("s")
    hang_s: float = parameter("s")

    def __post_init__(self):
        require_window(self)
        require(self.hang_s > 0.0, self, "hang_s must be positive.")

    def start(self, surroundings: Surroundings) -> "DeviceHangRunner":
        """Wait for the beginning."""
        return DeviceHangRunner(self, surroundings)


class DeviceHangRunner(FaultWindow):
    """Keeps its caller waiting, by the clock on the wall."""

    _has_hung = False

    def spoil(self, samples: np.ndarray, first: int, last: int) -> None:
        """Return late, and leave the samples as they are."""
        if not self._has_hung:
            self._has_hung = True
            time.sleep(self.effect.hang_s)
