# SPDX-License-Identifier: BSD-3-Clause
"""Lag of the amplifier and its leads, in front of the hysteresis."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

import control

from piezo_models.effects.effect import Effect
from piezo_models.effects.filtering import slowed
from piezo_models.effects.lag import Lag
from piezo_models.effects.sensor_lag import SensorLag

SHORTEST, SHORT, LONGEST = 0.02, 0.25, 5.0
"""Lags in front of the hysteresis, in rows, between which a row is simulated in parts: of one that
is shorter the mean is enough, and a longer one hardly moves within a row. A short one has settled
within the row."""

PARTS_OF_SHORT, PARTS_OF_LONG = 4, 8
"""Parts of a row for a short lag, and for one that goes on moving from part to part."""


@dataclass(frozen=True)
class AmplifierLag(Lag):
    """The voltage at the actuator follows the one asked for with a time constant.

    A held voltage x is approached as v' = (x - v) / T; the hysteresis gets the mean of v over each
    sample period, which is what a sample is behind a straight voltage. A sine cannot tell this lag
    from one behind the hysteresis, a step can: the hysteresis is flat after a reversal, so that it
    answers the first part of a step with less.
    """

    name: ClassVar[str] = "amplifier_lag"
    place: ClassVar[str] = "voltage"
    experiment: ClassVar[str] = "dynamics beside hysteresis: a fast square wave, and slow loops"
    indistinguishable_from: ClassVar[tuple[str, ...]] = ("delay", "sensor_lag")

    def lag(self) -> control.StateSpace | None:
        """Return the lag as a continuous system, as `Effect.lag` describes."""
        return slowed([1.0], [1.0, 1.0], self.time_constant_s)


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
            if isinstance(effect, Lag)]
    within = [each for each in rows if SHORTEST < each < LONGEST]
    if not within or samples_per_mean > 1:
        return 1
    return PARTS_OF_LONG if max(within) > SHORT else PARTS_OF_SHORT


def moves_from_part_to_part(parts: int) -> bool:
    """Tell whether the voltage goes on moving within the parts of a row, of `parts_of_rows`."""
    return parts == PARTS_OF_LONG
