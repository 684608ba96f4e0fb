# SPDX-License-Identifier: BSD-3-Clause
"""Base of the disturbances that depend on the time since a recording began."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

from piezo_common.arrays import FloatArray
from piezo_models.effects.effect import Effect


@dataclass(frozen=True)
class EffectOfTime(Effect):
    """An effect on the displacement whose only memory is the number of samples that have passed."""

    place: ClassVar[str] = "displacement"
    of_the_stage: ClassVar[bool] = False
    follows_voltage: ClassVar[bool] = False

    @abstractmethod
    def behind(self, signal: FloatArray, sample_period_s: float, first: int) -> FloatArray:
        """Return a part of the signal (um) behind the effect, (N,), after `first` samples."""

    def apply(self, signal: FloatArray, sample_period_s: float,
              rest: float | None = None) -> FloatArray:
        """Return the signal behind the effect, as `Effect.apply` describes."""
        return self.behind(signal, sample_period_s, 0)

    def acts_at_once(self, sample_period_s: float) -> bool:
        """Return True: every sample depends only on itself and on its time."""
        return True

    def advance(self, signal: FloatArray, sample_period_s: float,
                past: Any = None) -> tuple[FloatArray, Any]:
        """Continue the signal behind the effect; the past is the number of samples."""
        first = past or 0
        return self.behind(signal, sample_period_s, first), first + signal.size
