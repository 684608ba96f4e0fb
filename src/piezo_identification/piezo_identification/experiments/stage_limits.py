# SPDX-License-Identifier: BSD-3-Clause
"""The limits of a stage that experiments must respect."""

from dataclasses import dataclass

import numpy as np

from piezo_common.arrays import FloatArray


@dataclass(frozen=True)
class StageLimits:
    """Limits of a stage."""

    voltage_min_v: float = -20.0
    voltage_max_v: float = 120.0
    """Range of the amplifier."""
    slew_limit_v_per_s: float = 2e6
    """Largest rate of change of the voltage."""
    sample_rate_hz: float = 40_000.0
    """Sample clock of the stage."""
    rest_voltage_v: float = 0.0
    """Voltage of the stage at rest."""
    samples_per_tick: int = 40
    """Samples of one feedback period."""
    displacement_min_um: float = -np.inf
    displacement_max_um: float = np.inf
    """Range of valid sensor readings."""

    @property
    def span_v(self) -> float:
        """Return the width of the voltage range."""
        return self.voltage_max_v - self.voltage_min_v

    @property
    def displacement_span_um(self) -> float:
        """Return the width of the sensor's range; 0 if it is not bounded on both sides."""
        span_um = self.displacement_max_um - self.displacement_min_um
        return span_um if np.isfinite(span_um) else 0.0

    @property
    def middle_v(self) -> float:
        """Return the middle of the voltage range."""
        return 0.5 * (self.voltage_min_v + self.voltage_max_v)

    @property
    def largest_step_v(self) -> float:
        """Return the largest change between samples, a hundredth below the limit of the rate."""
        return 0.99 * self.slew_limit_v_per_s / self.sample_rate_hz

    def clip(self, voltage_v: FloatArray) -> FloatArray:
        """Return the voltage clipped to the range, which removes excess from rounding."""
        return np.clip(voltage_v, self.voltage_min_v, self.voltage_max_v)


USUAL_LIMITS = StageLimits()
"""Default limits, for experiments that are designed without a stage."""
