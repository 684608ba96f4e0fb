# SPDX-License-Identifier: BSD-3-Clause
"""Faults that act from one time to another."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import Surroundings, parameter, require

Spoil = Callable[[FloatArray], None]
"""Replaces samples within the window, in place."""


@dataclass(frozen=True)
class Fault(ABC):
    """An effect from ``begin_s`` to ``end_s`` of stage time."""

    name: ClassVar[str]

    begin_s: float = parameter("s")
    end_s: float = parameter("s")

    def __post_init__(self) -> None:
        require(0.0 <= self.begin_s < self.end_s, self,
                "begin_s must be at least 0 and below end_s.")

    def start(self, surroundings: Surroundings) -> "FaultWindow":
        """Wait for the beginning."""
        return FaultWindow(self, surroundings)

    @abstractmethod
    def spoiling(self, surroundings: Surroundings) -> Spoil:
        """Return what is done to the samples of the window, stretch by stretch."""


class FaultWindow:
    """The runner of a fault."""

    def __init__(self, effect: Fault, surroundings: Surroundings) -> None:
        self._spoil = effect.spoiling(surroundings)
        self._begin, self._end = (
            round(time_s / surroundings.sample_period_s)
            for time_s in (effect.begin_s, effect.end_s))
        self._at = 0

    def rest(self, level: float) -> float:
        """Return the level unchanged, as no fault acts before the stage starts."""
        return level

    def apply(self, samples: FloatArray) -> None:
        """Apply the fault to the samples of the window."""
        first, last = (min(max(edge - self._at, 0), samples.size)
                       for edge in (self._begin, self._end))
        if first < last:
            self._spoil(samples[first:last])
        self._at += samples.size
