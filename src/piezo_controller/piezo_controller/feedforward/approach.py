# SPDX-License-Identifier: BSD-3-Clause
"""Approach at the beginning of every run, within the common range of amplifier and model."""

import math

from piezo_models.hysteresis.preisach import PreisachModel

RAMP_S = 0.05
FADE_S = 0.05
ALIGNMENT_SAMPLES = 40


def aligned_samples(time_s: float, sample_period_s: float) -> int:
    """Return the samples of a duration, rounded up to a multiple of `ALIGNMENT_SAMPLES`."""
    ticks = math.ceil(time_s / sample_period_s / ALIGNMENT_SAMPLES - 1e-9)
    return ticks * ALIGNMENT_SAMPLES


def check_amplifier_range(hysteresis: PreisachModel, voltage_range_v: tuple[float, float],
                          start_voltage_v: float) -> None:
    """Raise ValueError if an amplifier cannot reach the voltage at which the model begins."""
    lowest_v, highest_v = voltage_range_v
    if not lowest_v <= hysteresis.voltage_min_v <= start_voltage_v <= highest_v:
        raise ValueError(
            f"the model begins at {hysteresis.voltage_min_v:g} V, the amplifier at "
            f"{lowest_v:g} V, the run at {start_voltage_v:g} V: identify the model over the "
            "amplifier's range")
