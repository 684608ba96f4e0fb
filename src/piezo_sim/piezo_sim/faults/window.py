# SPDX-License-Identifier: BSD-3-Clause
"""The time window of a fault."""

from abc import ABC, abstractmethod
from typing import Generic, Protocol, TypeVar

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import StartedEffect, Surroundings, require


class Fault(StartedEffect, Protocol):
    """An effect that acts from one time to another."""

    @property
    def begin_s(self) -> float:
        """Return the beginning (s of stage time)."""

    @property
    def end_s(self) -> float:
        """Return the end (s of stage time)."""


F = TypeVar("F", bound=Fault)


class FaultWindow(ABC, Generic[F]):
    """A fault from ``begin_s`` to ``end_s`` of stage time; the base of its runners."""

    def __init__(self, effect: F, surroundings: Surroundings) -> None:
        self.effect = effect
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
            self.spoil(samples, first, last)
        self._at += samples.size

    @abstractmethod
    def spoil(self, samples: FloatArray, first: int, last: int) -> None:
        """Replace the samples from `first` to `last`, the latter excluded."""


def require_window(effect: Fault) -> None:
    """Reject a window that is empty or begins before the stage starts."""
    require(0.0 <= effect.begin_s < effect.end_s, effect,
            "begin_s must be at least 0 and below end_s.")
