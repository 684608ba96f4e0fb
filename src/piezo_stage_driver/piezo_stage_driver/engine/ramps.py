# SPDX-License-Identifier: BSD-3-Clause
"""Ways from one voltage to another at a bounded rate."""

import math

import numpy as np

from piezo_stage_driver.engine.blocks import FLAG_RAMPING
from piezo_stage_driver.engine.program import Phase
from piezo_stage_driver.engine.sources import Ramp, Volts
from piezo_stage_driver.engine.ticks import Ticks


class Ramps:
    """Make ramps of one rate, or of one for each axis: the axis that takes longest decides."""

    def __init__(self, rate_v_per_s: Volts, ticks: Ticks):
        self._rate_v_per_s, self._ticks = rate_v_per_s, ticks

    @property
    def v_per_tick(self) -> Volts:
        """Tell how far a ramp goes in one tick (V)."""
        return self._rate_v_per_s * self._ticks.sample_period_s * self._ticks.samples_per_tick

    def samples(self, start_v: Volts, end_v: Volts) -> int:
        """Return how many samples of the clock a ramp takes."""
        longest_s = np.max(np.abs(np.subtract(end_v, start_v)) / self._rate_v_per_s)
        return math.ceil(longest_s / self._ticks.sample_period_s)

    def phase(self, name: str, start_v: Volts, end_v: Volts, pending: int = 0,
              decimation: int = 1) -> Phase:
        """Return a ramp as a phase that ends with a whole tick and a whole published sample.

        Parameters
        ----------
        pending : int
            Samples of the clock that an interrupted program left half collected; at least one
            sample completes them.
        decimation : int
            Samples of the clock in a published sample.
        """
        samples = max(self.samples(start_v, end_v), pending > 0)
        length = self._ticks.aligned(samples + pending, decimation) - pending
        return Phase(name, Ramp(start_v, end_v, samples), length, FLAG_RAMPING)
