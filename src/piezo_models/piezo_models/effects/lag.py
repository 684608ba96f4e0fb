# SPDX-License-Identifier: BSD-3-Clause
"""What every lag does to a signal, wherever it stands."""

from dataclasses import dataclass
from typing import Any, ClassVar

from piezo_common.arrays import FloatArray
from piezo_models.effects.effect import LEAST, MOST, Effect, Extent, parameter
from piezo_models.effects.filtering import filtered, filtered_on, unfiltered_period


@dataclass(frozen=True)
class Lag(Effect):
    """A signal follows another one behind a filter of unit gain at rest."""

    distortion: ClassVar[frozenset[str] | None] = frozenset()

    time_constant_s: float = parameter("s", "logarithm", LEAST, MOST)

    def apply(self, signal: FloatArray, sample_period_s: float,
              rest: float | None = None) -> FloatArray:
        """Return the signal behind the effect, as `Effect.apply` describes."""
        return filtered([1.0], self._denominator(), signal, sample_period_s, rest)

    def advance(self, signal: FloatArray, sample_period_s: float,
                past: Any = None) -> tuple[FloatArray, Any]:
        """Continue the signal behind the effect; the past is the filter's state."""
        return filtered_on([1.0], self._denominator(), signal, sample_period_s, past)

    def compensate(self, wanted: FloatArray, sample_period_s: float) -> FloatArray:
        """Divide the period by the lag, harmonic by harmonic."""
        return unfiltered_period([1.0], self._denominator(), wanted, sample_period_s)

    def _denominator(self) -> list[float]:
        """Return the coefficients of the filter, of the square of the rate first."""
        # With a square of zero the filter has a closed form, however short the lag is.
        return [0.0, self.time_constant_s, 1.0]

    @classmethod
    def bounds(cls, extent: Extent) -> dict[str, tuple[float, float]]:
        """Bound the time constant by what the recordings can show."""
        return {"time_constant_s": (1e-4 * extent.sample_period_s, 0.3 * extent.duration_s)}
