# SPDX-License-Identifier: BSD-3-Clause
"""The sample clock, its ticks, and lengths that are multiples of them."""

import math

from piezo_stage_driver.engine.program import StageRefusal

LONGEST_SAMPLE_PERIOD_S = 1.0


class Ticks:
    """Samples and ticks of a clock."""

    def __init__(self, sample_rate_hz: float, samples_per_tick: int):
        self.sample_period_s = 1.0 / sample_rate_hz
        self.samples_per_tick = samples_per_tick

    def samples_per_value(self, sample_period_s: float) -> int:
        """Return the number of clock samples for which a value of a waveform is held.

        Raises `StageRefusal` if the period is too short, too long, or no whole multiple of the
        clock's.
        """
        if not (math.isfinite(sample_period_s)
                and self.sample_period_s <= sample_period_s * (1 + 1e-9)
                and sample_period_s <= LONGEST_SAMPLE_PERIOD_S):
            raise StageRefusal(
                f"the sample period {sample_period_s:g} s is not within "
                f"[{self.sample_period_s:g}, {LONGEST_SAMPLE_PERIOD_S:g}] s: choose one that is")
        ratio = sample_period_s / self.sample_period_s
        if abs(ratio - round(ratio)) > 1e-6 * ratio:
            raise StageRefusal(
                f"the sample period {sample_period_s:g} s is no whole multiple of the "
                f"clock period {self.sample_period_s:g} s: choose one that is")
        return round(ratio)

    def aligned(self, samples: float, decimation: int) -> int:
        """Return a length rounded up to whole ticks and whole published samples."""
        unit = math.lcm(self.samples_per_tick, decimation)
        return math.ceil(samples / unit) * unit

    def stretch(self, samples: float, longest_samples: int) -> int:
        """Return how many samples to play at once: whole ticks, at least one."""
        ticks = min(samples, longest_samples) // self.samples_per_tick
        return max(1, int(ticks)) * self.samples_per_tick
