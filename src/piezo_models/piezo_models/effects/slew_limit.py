# SPDX-License-Identifier: BSD-3-Clause
"""Amplifier that cannot charge the actuator any faster."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit

from piezo_models.effects.effect import Effect, parameter


@njit(cache=True)
def _slewed(voltage, largest_step, start):
    output = np.empty(voltage.size)
    last = start
    for n in range(voltage.size):
        last += min(max(voltage[n] - last, -largest_step), largest_step)
        output[n] = last
    return output


@dataclass(frozen=True)
class SlewLimit(Effect):
    """The voltage changes no faster than a rate."""

    name: ClassVar[str] = "slew_limit"
    place: ClassVar[str] = "voltage"
    experiment: ClassVar[str] = "dynamics: steps of several sizes"

    slew_limit_v_per_s: float = parameter("V/s", "logarithm", 1e-6, 1e12)

    def apply(self, signal, sample_period_s, rest=None):
        """See `Effect.apply`."""
        start = float(signal[0] if rest is None else rest)
        step_v = self.slew_limit_v_per_s * sample_period_s
        # The output is the mean over each period of a voltage that changes steadily within it.
        reached = _slewed(np.ascontiguousarray(signal, dtype=float), step_v, start)
        before = np.append(start, reached[:-1])
        change = np.abs(reached - before)
        return reached - 0.5 * (reached - before) * np.minimum(1.0, change / step_v)

    def compensate(self, wanted, sample_period_s):
        """Ahead by as much as the change within each sample stays behind."""
        fastest = np.abs(np.diff(np.append(wanted, wanted[0]))).max() / sample_period_s
        if fastest > self.slew_limit_v_per_s:
            raise ValueError(
                f"the voltage would change by {fastest:.6g} V/s, the amplifier gives "
                f"{self.slew_limit_v_per_s:.6g} V/s: ask for slower motion"
            )
        return super().compensate(wanted, sample_period_s)

    @classmethod
    def starts(cls, evidence):
        """Limits below the fastest change, half as large each."""
        fastest = np.abs(np.diff(evidence.voltage_v)).max(initial=0.0) / evidence.sample_period_s
        return [cls(fastest * 0.6**step) for step in range(1, 16)] if fastest > 0.0 else []

    @classmethod
    def lacks_excitation(cls, evidence):
        """A limit shows where the voltage changes fast."""
        if np.ptp(evidence.voltage_v) == 0.0:
            return "the voltage does not change"
        return None
