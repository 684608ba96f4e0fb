# SPDX-License-Identifier: BSD-3-Clause
"""The stage that a run is planned for, and the approach with which every run begins."""

import math
from dataclasses import dataclass

from piezo_models.hysteresis.preisach import PreisachModel

RAMP_S = 0.05
FADE_S = 0.05
ALIGNMENT_SAMPLES = 40


@dataclass(frozen=True)
class StageClock:
    """Limits and clock of the stage that a plan is made for."""

    voltage_range_v: tuple[float, float] = (-20.0, 120.0)
    slew_limit_v_per_s: float = 2e6
    rest_voltage_v: float = 0.0
    sample_rate_hz: float = 40000.0
    samples_per_tick: int = 40

    max_feedback_v: float = math.inf
    """Largest feedback voltage that the stage accepts, of either sign (V)."""

    @property
    def sample_period_s(self) -> float:
        """Return the period of the sample clock (s)."""
        return 1.0 / self.sample_rate_hz

    @property
    def tick_s(self) -> float:
        """Return the period of the feedback (s)."""
        return self.samples_per_tick / self.sample_rate_hz


USUAL_STAGE = StageClock()
"""The stage of the thesis."""


def aligned_samples(time_s: float, sample_period_s: float) -> int:
    """Return the samples of a duration, rounded up to a multiple of `ALIGNMENT_SAMPLES`."""
    ticks = math.ceil(time_s / sample_period_s / ALIGNMENT_SAMPLES - 1e-9)
    return ticks * ALIGNMENT_SAMPLES


def check_amplifier_range(hysteresis: PreisachModel, stage: StageClock) -> None:
    """Raise ValueError if an amplifier cannot reach the voltage at which the model begins."""
    lowest_v, highest_v = stage.voltage_range_v
    if not lowest_v <= hysteresis.voltage_min_v <= stage.rest_voltage_v <= highest_v:
        raise ValueError(
            f"the model begins at {hysteresis.voltage_min_v:g} V, the amplifier at "
            f"{lowest_v:g} V, the run at {stage.rest_voltage_v:g} V: identify the model over the "
            "amplifier's range")
