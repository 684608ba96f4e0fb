# SPDX-License-Identifier: BSD-3-Clause
"""Faults that act from one time to another."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import Surroundings, parameter, require
from piezo_sim.plant.state_runner import StateRunner

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

    def start(self, surroundings: Surroundings) -> StateRunner:
        """Wait for the beginning; no fault acts before the stage starts."""
        spoil = self.spoiling(surroundings)
        edges = [round(time_s / surroundings.sample_period_s)
                 for time_s in (self.begin_s, self.end_s)]

        def apply(samples: FloatArray, at: int) -> tuple[int]:
            first, last = (min(max(edge - at, 0), samples.size) for edge in edges)
            if first < last:
                spoil(samples[first:last])
            return (at + samples.size,)

        return StateRunner(apply, lambda level: ((0,), level))

    @abstractmethod
    def spoiling(self, surroundings: Surroundings) -> Spoil:
        """Return what is done to the samples of the window, stretch by stretch."""
