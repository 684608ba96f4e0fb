# SPDX-License-Identifier: BSD-3-Clause
"""Amplifier with a limited charging current."""

from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numba import njit

from piezo_common.arrays import FloatArray
from piezo_models.effects.effect import LEAST, MOST, Effect, Evidence, Extent, parameter

SCANNED_PARTS = (4.0, 2.0, 1.2, 0.98, 0.95, 0.9, 0.82, 0.7, 0.5, 0.3, 0.15, 0.05, 0.01)
"""Limits that are tried, as fractions of the fastest change; one above 1 delays changes within
their sample."""
SCANNED_FALL_RATIOS = (1.0, 4.0, 0.25)


@njit(cache=True, nogil=True)
def _slewed(voltage: FloatArray, rise: float, fall: float, change_per_v: float,
            start: float) -> tuple[FloatArray, float]:
    output = np.empty(voltage.size)
    last = start
    for n in range(voltage.size):
        missing = voltage[n] - last
        step = (rise if missing > 0.0 else fall) * max(1.0 + change_per_v * last, 0.01)
        way = min(abs(missing), step)
        # The mean over the period of a voltage that changes at a constant rate until it arrives.
        reached = last + (way if missing > 0.0 else -way)
        output[n] = reached - 0.5 * (reached - last) * min(1.0, way / step)
        last = reached
    return output, last


@dataclass(frozen=True)
class SlewLimit(Effect):
    """The voltage rises no faster than a rate, and falls no faster than `fall_ratio` times it.

    The rates apply at 0 V. They change by the fraction `change_per_v` with every volt, as the
    capacitance of the actuator does.
    """

    name: ClassVar[str] = "slew_limit"
    place: ClassVar[str] = "voltage"
    experiment: ClassVar[str] = "dynamics: steps of several sizes"
    distortion: ClassVar[frozenset[str] | None] = frozenset({"odd"})
    confounded_with: ClassVar[tuple[str, ...]] = ("vibration_mode",)

    slew_limit_v_per_s: float = parameter("V/s", "logarithm", LEAST, MOST)
    fall_ratio: float = parameter("1", "logarithm", 0.2, 5.0, default=1.0)
    change_per_v: float = parameter("1/V", "linear", -0.02, 0.02, default=0.0)

    def apply(self, signal: FloatArray, sample_period_s: float,
              rest: float | None = None) -> FloatArray:
        """Return the signal behind the effect, as `Effect.apply` describes."""
        return self.advance(signal, sample_period_s, rest)[0]

    def advance(self, signal: FloatArray, sample_period_s: float,
                past: Any = None) -> tuple[FloatArray, Any]:
        """Continue the signal behind the effect; the past is the last voltage reached."""
        start = float(signal[0] if past is None else past)
        rise_v = self.slew_limit_v_per_s * sample_period_s
        return _slewed(np.ascontiguousarray(signal, dtype=float), rise_v, self.fall_ratio * rise_v,
                       self.change_per_v, start)

    def compensate(self, wanted: FloatArray, sample_period_s: float) -> FloatArray:
        """Return the voltage with a lead that compensates the lag within each sample."""
        changes = np.diff(np.append(wanted, wanted[0])) / sample_period_s
        limits = self.slew_limit_v_per_s * np.maximum(1.0 + self.change_per_v * wanted, 0.01)
        limits = np.where(changes > 0.0, limits, self.fall_ratio * limits)
        worst = int(np.argmax(np.abs(changes) / limits))
        if abs(changes[worst]) > limits[worst]:
            raise ValueError(
                f"the voltage would change by {abs(changes[worst]):.6g} V/s, the amplifier gives "
                f"{limits[worst]:.6g} V/s: ask for slower motion"
            )
        return super().compensate(wanted, sample_period_s)

    @classmethod
    def bounds(cls, extent: Extent) -> dict[str, tuple[float, float]]:
        """Bound the rate: slow enough to be visible, fast enough to allow motion."""
        return {"slew_limit_v_per_s": (1e-3 * extent.span_v / extent.duration_s,
                                       10.0 * extent.span_v / extent.sample_period_s)}

    @classmethod
    def starts(cls, evidence: Evidence) -> list[Self]:
        """Start with limits around the fastest change, in both directions or in one."""
        fastest = np.abs(np.diff(evidence.voltage_v)).max(initial=0.0) / evidence.sample_period_s
        if fastest == 0.0:
            return []
        return [
            cls(fastest * part * max(1.0, 1.0 / ratio), ratio)
            for ratio in SCANNED_FALL_RATIOS for part in SCANNED_PARTS
        ]

    @classmethod
    def lacks_excitation(cls, evidence: Evidence) -> str | None:
        """Require a voltage that changes."""
        if np.ptp(evidence.voltage_v) == 0.0:
            return "the voltage does not change"
        return None
