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

SETTLED, LONGEST = 0.087, 5.0
"""Limits of lags in front of the hysteresis, in rows. A lag below the first has settled within
the row up to 1e-5 and acts behind the hysteresis (`as_rows_show`). Between them, a row is simulated
in parts; a longer lag hardly moves within a row."""

PARTS = 8
"""Parts of a row in which a lag moves the voltage. A mode with half a period in a row then rings
with an error of 0.3 %; with four parts, of 5 %."""


@dataclass(frozen=True)
class AmplifierLag(Lag):
    """The voltage at the actuator follows the commanded one with a time constant.

    For a held voltage x, v' = (x - v) / T. The hysteresis gets the mean of v over each sample
    period, which equals the sample for a straight voltage. A sine cannot distinguish this lag from
    one behind the hysteresis. A step can: the hysteresis is flat after a reversal, so its response
    to the first part of a step is smaller.
    """

    name: ClassVar[str] = "amplifier_lag"
    place: ClassVar[str] = "voltage"
    experiment: ClassVar[str] = "dynamics and hysteresis: a fast square wave, and slow loops"
    confounded_with: ClassVar[tuple[str, ...]] = ("delay", "sensor_lag")

    def lag(self) -> control.StateSpace | None:
        """Return the lag as a continuous system, as `Effect.lag` describes."""
        return slowed([1.0], [1.0, 1.0], self.time_constant_s)


@dataclass(frozen=True)
class SettledLag(Lag):
    """A lag of the voltage that acts as a linear system behind the hysteresis.

    The hysteresis does not store overshoot within the row.
    """

    name: ClassVar[str] = "settled_lag"
    place: ClassVar[str] = "linear"

    of: Lag = field(kw_only=True)
    """The lag in front of the hysteresis."""

    def __post_init__(self) -> None:
        """Check nothing, as the original lag was checked."""

    def state_space(self) -> control.StateSpace:
        """Return the lag as a continuous system."""
        system = self.of.lag()
        assert system is not None
        return system


def as_rows_show(effects: Iterable[Effect], sample_period_s: float) -> tuple[Effect, ...]:
    """Return the effects with lags that settle within a row moved behind the hysteresis.

    Only oscillation within a row depends on such a lag, through its phase. The mean over a row or a
    part of it does not contain that phase.
    """
    return tuple(
        SettledLag(effect.time_constant_s, of=effect)
        if isinstance(effect, Lag) and effect.place == "voltage"
        and effect.time_constant_s <= SETTLED * sample_period_s else effect for effect in effects)


def lag_behind_hysteresis(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """Return the effects with the amplifier's lag as a sensor lag, which is equal for a sine."""
    return tuple(SensorLag(effect.time_constant_s) if isinstance(effect, AmplifierLag) else effect
                 for effect in effects)


def parts_of_rows(effects: Iterable[Effect], sample_period_s: float,
                  samples_per_mean: int = 1) -> int:
    """Return the number of parts in which a row is simulated for lags before the hysteresis.

    Parameters
    ----------
    effects : iterable of Effect
        Effects on the voltage, as `as_rows_show` returns them.
    samples_per_mean : int
        Samples averaged in a row; a row that is a mean of several is not divided.
    """
    moves = any(SETTLED < effect.time_constant_s / sample_period_s < LONGEST
                for effect in effects if isinstance(effect, Lag))
    return PARTS if moves and samples_per_mean == 1 else 1
