# SPDX-License-Identifier: BSD-3-Clause
"""Ramps from one voltage to another at a bounded rate."""

import math

import numpy as np

from piezo_stage_driver.engine.blocks import FLAG_RAMPING
from piezo_stage_driver.engine.program import Phase
from piezo_stage_driver.engine.sources import Ramp, Volts
from piezo_stage_driver.engine.ticks import Ticks


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
