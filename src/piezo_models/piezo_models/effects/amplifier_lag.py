# SPDX-License-Identifier: BSD-3-Clause
"""Lag of the amplifier and its leads, in front of the hysteresis."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import control

from piezo_common.arrays import FloatArray
from piezo_models.effects.effect import LEAST, MOST, Effect, Evidence, Extent, parameter
from piezo_models.effects.filtering import filtered, filtered_on, slowed, unfiltered_period
from piezo_models.effects.sensor_lag import SensorLag

SHORTEST, SHORT, LONGEST = 0.02, 0.25, 5.0
"""Lags in front of the hysteresis, in rows, between which a row is simulated in parts: of one that
is shorter the mean is enough, and a longer one hardly moves within a row. A short one has settled
within the row."""

PARTS_OF_SHORT, PARTS_OF_LONG = 4, 8
"""Parts of a row for a short lag, and for one that goes on moving from part to part."""


@dataclass(frozen=True)
class AmplifierLag(Effect):
    """The voltage at the actuator follows the one asked for with a time constant.

    A held voltage x is approached as v' = (x - v) / T; the hysteresis gets the mean of v over each
    sample period. A sine cannot tell this lag from one behind the hysteresis, a step can: the
    hysteresis is flat after a reversal, so that it answers the first part of a step with less.
    """

    name: ClassVar[str] = "amplifier_lag"
    place: ClassVar[str] = "voltage"
    experiment: ClassVar[str] = "dynamics beside hysteresis: a fast square wave, and slow loops"
    distortion: ClassVar[frozenset[str] | None] = frozenset()
    indistinguishable_from: ClassVar[tuple[str, ...]] = ("delay", "sensor_lag")

    time_constant_s: float = parameter("s", "logarithm", LEAST, MOST)

    # The mean over a period behind a held voltage is what a sample is behind a straight one.
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

    def lag(self) -> control.StateSpace | None:
        """Return the lag as a continuous system, as `Effect.lag` describes."""
        return slowed([1.0], [1.0, 1.0], self.time_constant_s)

    def _denominator(self) -> list[float]:
        # With a square of zero the filter has a closed form, however short the lag is.
        return [0.0, self.time_constant_s, 1.0]

    @classmethod
    def bounds(cls, extent: Extent) -> dict[str, tuple[float, float]]:
        """Bound the time constant by what the recordings can show."""
        return {"time_constant_s": (1e-4 * extent.sample_period_s, 0.3 * extent.duration_s)}

    @classmethod
    def starts(cls, evidence: Evidence) -> list[Self]:
        """Return none: `identify` fits this lag together with the dynamics that it resembles."""
        return []


def lag_behind_hysteresis(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """Return effects with the amplifier's lag behind the hysteresis, where a sine sees it, too."""
    return tuple(SensorLag(effect.time_constant_s) if isinstance(effect, AmplifierLag) else effect
                 for effect in effects)


def parts_of_rows(effects: Iterable[Effect], sample_period_s: float,
                  samples_per_mean: int = 1) -> int:
    """Return in how many parts a row is simulated where lags stand in front of the hysteresis.

    Parameters
    ----------
    effects : iterable of Effect
        On the voltage.
    samples_per_mean : int
        Rows that are means of several samples stay whole.
    """
    rows = [effect.time_constant_s / sample_period_s for effect in effects
            if isinstance(effect, AmplifierLag)]
    within = [each for each in rows if SHORTEST < each < LONGEST]
    if not within or samples_per_mean > 1:
        return 1
    return PARTS_OF_LONG if max(within) > SHORT else PARTS_OF_SHORT


def moves_from_part_to_part(parts: int) -> bool:
    """Tell whether the voltage goes on moving within the parts of a row, of `parts_of_rows`."""
    return parts == PARTS_OF_LONG
