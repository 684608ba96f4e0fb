# SPDX-License-Identifier: BSD-3-Clause
"""Lag of the amplifier and its leads, in front of the hysteresis."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import ClassVar

import control

from piezo_models.effects.effect import Effect
from piezo_models.effects.filtering import slowed
from piezo_models.effects.lag import Lag
from piezo_models.effects.sensor_lag import SensorLag

SETTLED, SHORT, LONGEST = 0.087, 0.25, 5.0
"""Lags in front of the hysteresis, in rows: one below the first has settled within the row but for
1e-5, and acts as behind the hysteresis (`as_rows_show`). From there to the last a row is simulated
in parts, of a short one in few: a longer one hardly moves within a row."""

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


@dataclass(frozen=True)
class SettledLag(Lag):
    """A lag of the voltage as a linear system behind the hysteresis, whose output it delays.

    What overshoots within the row is not remembered by the hysteresis.

    Attributes
    ----------
    of : Lag
        In front of the hysteresis.
    """

    name: ClassVar[str] = "settled_lag"
    place: ClassVar[str] = "linear"

    of: Lag = field(kw_only=True)

    def __post_init__(self) -> None:
        """Check nothing: the lag was checked."""

    def state_space(self) -> control.StateSpace:
        """Return the lag as a continuous system."""
        system = self.of.lag()
        assert system is not None
        return system


def as_rows_show(effects: Iterable[Effect], sample_period_s: float) -> tuple[Effect, ...]:
    """Return effects, those lags behind the hysteresis that have settled within a row.

    Only what rings within a row sees such a lag, and that by its phase, which a mean over the row
    or a part of it does not have.
    """
    return tuple(
        SettledLag(effect.time_constant_s, of=effect)
        if isinstance(effect, Lag) and effect.place == "voltage"
        and effect.time_constant_s <= SETTLED * sample_period_s else effect for effect in effects)


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
        On the voltage, of `as_rows_show`.
    samples_per_mean : int
        Rows that are means of several samples stay whole.
    """
    rows = [effect.time_constant_s / sample_period_s for effect in effects
            if isinstance(effect, Lag)]
    within = [each for each in rows if SETTLED < each < LONGEST]
    if not within or samples_per_mean > 1:
        return 1
    return PARTS_OF_LONG if max(within) > SHORT else PARTS_OF_SHORT


def moves_from_part_to_part(parts: int) -> bool:
    """Tell whether the voltage goes on moving within the parts of a row, of `parts_of_rows`."""
    return parts == PARTS_OF_LONG
