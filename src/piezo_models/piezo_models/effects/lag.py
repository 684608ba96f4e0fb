# SPDX-License-Identifier: BSD-3-Clause
"""The common base of all lags of a signal."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_models.effects.delay import Delay
from piezo_models.effects.effect import LEAST, MOST, Effect, Evidence, Extent, parameter
from piezo_models.effects.filtering import filtered, filtered_on, unfiltered_period

SCANNED = np.geomspace(0.1, 1000.0, 13)
"""Time constants that are tried, in sample periods."""
LIKELY = (1e-3, 3.0)
"""Bounds of the factor on the best time constant of the scan, which is its fitted gain."""


@dataclass(frozen=True)
class Lag(Effect):
    """A signal passes a filter of unit DC gain."""

    distortion: ClassVar[frozenset[str] | None] = frozenset()

    time_constant_s: float = parameter("s", "logarithm", LEAST, MOST)

    def apply(self, signal: FloatArray, sample_period_s: float,
              rest: float | None = None) -> FloatArray:
        """Return the signal behind the effect, as `Effect.apply` describes."""
        return filtered(self._numerator(), self._denominator(), signal, sample_period_s, rest)

    def advance(self, signal: FloatArray, sample_period_s: float,
                past: Any = None) -> tuple[FloatArray, Any]:
        """Continue the signal behind the effect; the past is the filter's state."""
        return filtered_on(
            self._numerator(), self._denominator(), signal, sample_period_s, past)

    def compensate(self, wanted: FloatArray, sample_period_s: float) -> FloatArray:
        """Divide the period by the lag, harmonic by harmonic."""
        return unfiltered_period(
            self._numerator(), self._denominator(), wanted, sample_period_s)

    def response(self, s: ComplexArray) -> ComplexArray:
        """Return the factor of the effect in the frequency response."""
        return np.asarray(np.polyval(self._numerator(), s) / np.polyval(self._denominator(), s))

    @property
    def slow_delay_s(self) -> float:
        """Return the delay of slow signals in s."""
        return self.time_constant_s

    @property
    def ringing_s(self) -> float:
        """Return the time constant with which it rings out in s; 0 if it does not ring."""
        return 0.0

    def _numerator(self) -> list[float]:
        """Return the coefficients of the filter's numerator, the highest power first."""
        return [1.0]

    def _denominator(self) -> list[float]:
        """Return the coefficients of the filter's denominator, the highest power first."""
        # With a square of zero the filter has a closed form, however short the lag is.
        return [0.0, self.time_constant_s, 1.0]

    @classmethod
    def bounds(cls, extent: Extent) -> dict[str, tuple[float, float]]:
        """Bound the time constant by what the recordings can show."""
        return {"time_constant_s": (1e-4 * extent.sample_period_s, 0.3 * extent.duration_s)}

    @classmethod
    def tried(cls, time_constant_s: float) -> Self:
        """Return the lag with a time constant of the scan."""
        return cls(time_constant_s)

    @classmethod
    def scanned(cls, evidence: Evidence) -> list[tuple[Self, float]]:
        """Return lags of a scan, best first, with the gain of their contribution; may be empty.

        A lag in front of the hysteresis moves the displacement much as one behind it does; they
        differ where the voltage has just reversed.
        """
        found = evidence.best(
            [cls.tried(time_s) for time_s in evidence.sample_period_s * SCANNED],
            lambda shape: (shape.apply(evidence.displacement_um, evidence.sample_period_s)
                           - evidence.displacement_um)[:, None])
        return [(shape, float(gains[0])) for shape, gains in found if gains[0] > 0.0]

    @classmethod
    def starts(cls, evidence: Evidence) -> list[Self]:
        """Start with the best of a scan."""
        found = cls.scanned(evidence)
        # A gain below one means a shorter lag.
        return [replace(shape, time_constant_s=shape.time_constant_s * float(np.clip(
            gain, *LIKELY))) for shape, gain in found]

    lacks_excitation = Delay.lacks_excitation
