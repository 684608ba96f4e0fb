# SPDX-License-Identifier: BSD-3-Clause
"""Lag of the amplifier and its leads, in front of the hysteresis."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, ClassVar

import control
import numpy as np

from piezo_common.arrays import FloatArray
from piezo_models.effects.bouc_wen_hysteresis import BoucWenHysteresis
from piezo_models.effects.effect import Effect
from piezo_models.effects.filtering import slowed
from piezo_models.effects.lag import Lag
from piezo_models.effects.sensor_lag import SensorLag

SETTLED, LONGEST = 0.087, 5.0
"""Limits of lags in front of the hysteresis, in rows. A lag below the first has settled within
the row up to 1e-5 and acts behind the hysteresis (`as_rows_show`), unless it rings beyond the row.
Between them, a row is simulated in parts; a longer lag hardly moves within a row."""

LEAST_OVERSHOOT = 1e-2
"""Smallest overshoot, relative to a step, that the hysteresis is given. It changes the
loops in proportion to its square."""

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

    The hysteresis still remembers its overshoot; see `with_overshoot`.
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

    @property
    def overshoots(self) -> tuple[float, ...]:
        """Extremes after a step, beyond its end and relative to it; empty without overshoot."""
        damping = 0.5 / max(getattr(self.of, "quality_factor", 0.0), 0.5)
        if damping >= 1.0:
            return ()
        decay = -np.pi * damping / np.sqrt(1.0 - damping**2)
        numbers = np.arange(1, 1 + int(np.log(LEAST_OVERSHOOT) / decay))
        return tuple((-np.exp(decay * numbers) * (-1.0) ** numbers).tolist())


def overshooting(effects: Iterable[Effect]) -> tuple[SettledLag, ...]:
    """Return the settled lags that overshoot."""
    return tuple(each for each in effects if isinstance(each, SettledLag) and each.overshoots)


def with_overshoot(voltage_v: FloatArray, before_v: float,
                   effects: Iterable[Effect]) -> tuple[FloatArray, int]:
    """Return the extremes of the voltage within each row, followed by the voltage of the row.

    A hysteresis that does not depend on rate needs no more of a lag that settles within the row. Of
    the effects, `overshooting` ones matter. The voltages, (N count,), come with the number of them
    in each row: 1 without overshoot.
    """
    extremes = [size for lag in overshooting(effects) for size in lag.overshoots]
    if not extremes:
        return voltage_v, 1
    steps_v = np.diff(voltage_v, prepend=before_v)
    return np.column_stack([
        *(voltage_v + size * steps_v for size in extremes), voltage_v]).ravel(), 1 + len(extremes)


def advance_with_overshoot(effect: Effect, voltage_v: FloatArray, sample_period_s: float, past: Any,
                           effects: Iterable[Effect]) -> tuple[FloatArray, Any]:
    """Continue an effect on the voltage, as `Effect.advance`.

    A hysteresis also gets the extremes of the voltage within each row; see `with_overshoot`.
    """
    if not isinstance(effect, BoucWenHysteresis):
        return effect.advance(voltage_v, sample_period_s, past)
    before_v = float(voltage_v[0] if past is None else past[0])
    extremes_v, count = with_overshoot(voltage_v, before_v, effects)
    behind_v, past = effect.advance(extremes_v, sample_period_s, past)
    return behind_v[count - 1 :: count], past


def as_rows_show(effects: Iterable[Effect], sample_period_s: float) -> tuple[Effect, ...]:
    """Return the effects with lags that settle within a row moved behind the hysteresis.

    Only oscillation within a row depends on such a lag, through its phase. The mean over a row or a
    part of it does not contain that phase.
    """
    return tuple(
        SettledLag(effect.time_constant_s, of=effect)
        if isinstance(effect, Lag) and effect.place == "voltage"
        and effect.time_constant_s <= SETTLED * sample_period_s
        and effect.ringing_s <= sample_period_s else effect for effect in effects)


def lag_behind_hysteresis(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """Return the effects with the amplifier's lag as a sensor lag, which is equal for a sine."""
    return tuple(SensorLag(effect.time_constant_s) if isinstance(effect, AmplifierLag) else effect
                 for effect in effects)


def parts_of_rows(effects: Iterable[Effect], sample_period_s: float,
                  samples_per_mean: int = 1) -> int:
    """Return the number of parts in which a row is simulated for lags before the hysteresis.

    The effects on the voltage are those of `as_rows_show`. A row that is a mean of several samples
    is not divided.
    """
    moves = any(effect.time_constant_s < LONGEST * sample_period_s
                for effect in effects if isinstance(effect, Lag) and effect.place == "voltage")
    return PARTS if moves and samples_per_mean == 1 else 1
