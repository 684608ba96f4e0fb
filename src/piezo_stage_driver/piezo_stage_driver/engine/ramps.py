# SPDX-License-Identifier: BSD-3-Clause
"""Ways from one voltage to another at a bounded rate."""

import math

from piezo_stage_driver.engine.blocks import FLAG_RAMPING
from piezo_stage_driver.engine.program import Phase
from piezo_stage_driver.engine.sources import Ramp
from piezo_stage_driver.engine.ticks import Ticks


class Ramps:
    """Make ramps of one rate."""

    def __init__(self, rate_v_per_s: float, ticks: Ticks):
        self._rate_v_per_s, self._ticks = rate_v_per_s, ticks

    @property
    def v_per_tick(self) -> float:
        """Tell how far a ramp goes in one tick (V)."""
        return self._rate_v_per_s * self._ticks.sample_period_s * self._ticks.samples_per_tick

    def samples(self, start_v: float, end_v: float) -> int:
        """Return how many samples of the clock a ramp takes."""
        return math.ceil(abs(end_v - start_v) / self._rate_v_per_s / self._ticks.sample_period_s)

    def phase(self, name: str, start_v: float, end_v: float, pending: int = 0,
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
