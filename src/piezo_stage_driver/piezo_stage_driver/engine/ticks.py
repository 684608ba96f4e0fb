# SPDX-License-Identifier: BSD-3-Clause
"""The sample clock, its ticks, lengths that are multiples of them, and ramps of such lengths."""

import math

import numpy as np

from piezo_stage_driver.engine.blocks import FLAG_RAMPING
from piezo_stage_driver.engine.program import Phase, StageRefusal
from piezo_stage_driver.engine.sources import Ramp, Volts

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


class Ramps:
    """Make ramps of one rate, or of one rate per axis: the slowest axis determines the duration."""

    def __init__(self, rate_v_per_s: Volts, ticks: Ticks):
        self._rate_v_per_s, self._ticks = rate_v_per_s, ticks

    @property
    def v_per_tick(self) -> Volts:
        """Return the change of the voltage by a ramp in one tick (V)."""
        return self._rate_v_per_s * self._ticks.sample_period_s * self._ticks.samples_per_tick

    def samples(self, start_v: Volts, end_v: Volts) -> int:
        """Return the duration of a ramp in samples of the clock."""
        longest_s = np.max(np.abs(np.subtract(end_v, start_v)) / self._rate_v_per_s)
        return math.ceil(longest_s / self._ticks.sample_period_s)

    def phase(self, name: str, start_v: Volts, end_v: Volts, pending: int = 0,
              decimation: int = 1) -> Phase:
        """Return a ramp as a phase that ends with a whole tick and a whole published sample.

        It also completes the samples that an interrupted program left pending, by at least one
        more. A published sample is the mean of `decimation` samples of the clock.
        """
        samples = max(self.samples(start_v, end_v), pending > 0)
        length = self._ticks.aligned(samples + pending, decimation) - pending
        return Phase(name, Ramp(start_v, end_v, samples), length, FLAG_RAMPING)
