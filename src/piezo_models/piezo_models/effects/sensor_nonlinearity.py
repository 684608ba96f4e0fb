# SPDX-License-Identifier: BSD-3-Clause
"""Curved characteristic of the sensor."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_models.effects.effect import LEAST, MOST, Effect, Evidence, Extent, parameter


@dataclass(frozen=True)
class SensorNonlinearity(Effect):
    """The sensor's error is a sum of Legendre polynomials of degree 1 to 4 over its range."""

    name: ClassVar[str] = "sensor_nonlinearity"
    place: ClassVar[str] = "sensor"
    remembers: ClassVar[bool] = False
    experiment: ClassVar[str] = "hysteresis: harmonics over the whole range, and fast tones"
    distortion: ClassVar[frozenset[str] | None] = frozenset({"even", "odd"})
    confounded_with: ClassVar[tuple[str, ...]] = ("stiffening",)
    same_without_dynamics: ClassVar[tuple[str, ...]] = ("stiffening",)

    first_um: float = parameter("um")
    second_um: float = parameter("um")
    third_um: float = parameter("um")
    fourth_um: float = parameter("um")
    centre_um: float = parameter("um", "fixed")
    half_range_um: float = parameter("um", "fixed", LEAST, MOST)

    def deviations(self, signal: FloatArray) -> FloatArray:
        """Return the contribution of each polynomial with a size of 1 um, shape (N, 4)."""
        x = np.clip((signal - self.centre_um) / self.half_range_um, -1.5, 1.5)
        square = x * x
        return np.column_stack([
            x, 0.5 * (3.0 * square - 1.0), 0.5 * (5.0 * square - 3.0) * x,
            0.125 * ((35.0 * square - 30.0) * square + 3.0),
        ])

    def apply(self, signal: FloatArray, sample_period_s: float,
              rest: float | None = None) -> FloatArray:
        """Return the signal behind the effect, as `Effect.apply` describes."""
        return signal + self.deviations(signal) @ (
            self.first_um, self.second_um, self.third_um, self.fourth_um
        )

    @classmethod
    def bounds(cls, extent: Extent) -> dict[str, tuple[float, float]]:
        """Bound the polynomials: the error of the sensor is less than its reading."""
        names = ("first_um", "second_um", "third_um", "fourth_um")
        return {name: (-0.5 * extent.travel_um, 0.5 * extent.travel_um) for name in names}

    def impossible(self, extent: Extent) -> str | None:
        """Reject a sensor whose reading decreases with the displacement."""
        position_um = self.centre_um + self.half_range_um * np.linspace(-1.0, 1.0, 201)
        if np.any(np.diff(self.apply(position_um, 1.0)) <= 0.0):
            return "the sensor would read less where the displacement is more"
        return None

    @classmethod
    def starts(cls, evidence: Evidence) -> list[Self]:
        """Start with the least-squares polynomials over the travel of the recording."""
        low, high = evidence.displacement_um.min(), evidence.displacement_um.max()
        if evidence.travel_um == 0.0:
            return []
        shape = cls(0.0, 0.0, 0.0, 0.0, 0.5 * (low + high), 0.5 * (high - low))
        gains, _ = evidence.reduction(shape.deviations(evidence.displacement_um))
        first_um, second_um, third_um, fourth_um = gains.tolist()
        return [cls(first_um, second_um, third_um, fourth_um, shape.centre_um,
                    shape.half_range_um)]
