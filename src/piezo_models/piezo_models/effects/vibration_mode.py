# SPDX-License-Identifier: BSD-3-Clause
"""An additional mode of vibration."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import ClassVar, Self

import control
import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_models.effects.effect import LEAST, MOST, Effect, Evidence, Extent, parameter
from piezo_models.effects.filtering import filtered

SCANNED_DAMPING_RATIOS = (0.01, 0.05)
LOWEST_PERIODS = 20
"""Fewest periods of a mode in a recording for it to be visible."""


@dataclass(frozen=True)
class VibrationMode(Effect):
    """An additional mode with the fraction `participation` of the displacement.

    The modes of a structure act in parallel: the additional mode has the same input as the others,
    and adds an antiresonance with each of them. The DC gain does not change.
    """

    name: ClassVar[str] = "vibration_mode"
    place: ClassVar[str] = "modes"
    several: ClassVar[bool] = True
    experiment: ClassVar[str] = "dynamics: steps, or tones up to the highest frequency of interest"
    distortion: ClassVar[frozenset[str] | None] = frozenset()
    confounded_with: ClassVar[tuple[str, ...]] = ("slew_limit",)

    frequency_rad_per_s: float = parameter("rad/s", "logarithm", LEAST, MOST)
    damping_ratio: float = parameter("1", "logarithm", 1e-3, 0.4)
    participation: float = parameter("1", "linear", -2.0, 3.0)

    def _mode(self) -> tuple[list[float], list[float]]:
        w = self.frequency_rad_per_s
        return [w * w], [1.0, 2.0 * self.damping_ratio * w, w * w]

    def _parts(self) -> tuple[float, float]:
        """Return the parts of the displacement that follow the mode and its scaled velocity."""
        return self.participation, 0.0

    def state_space(self) -> control.StateSpace:
        """Return the continuous system of the mode alone, with unit DC gain."""
        return self._system(1.0, 0.0)

    def _system(self, position: float, velocity: float) -> control.StateSpace:
        w = self.frequency_rad_per_s
        return control.ss([[0.0, w], [-w, -2.0 * self.damping_ratio * w]], [[0.0], [w]],
                          [[position, velocity]], [[0.0]])

    def branch_response(self, s: ComplexArray) -> ComplexArray:
        """Return the mode's part of the response at complex rates s in rad/s, in their shape."""
        position, velocity = self._parts()
        ratio = s / self.frequency_rad_per_s
        return (position + velocity * ratio) / (1.0 + 2.0 * self.damping_ratio * ratio + ratio**2)

    def branch_delay_s(self) -> float:
        """Return the delay of slow signals that the mode adds, in s."""
        position, velocity = self._parts()
        return (2.0 * self.damping_ratio * position - velocity) / self.frequency_rad_per_s

    def apply(self, signal: FloatArray, sample_period_s: float,
              rest: float | None = None) -> FloatArray:
        """Return the signal behind the mode if it is the only one."""
        response = self._response(signal, sample_period_s, rest)
        return signal + self.participation * (response - signal)

    def _response(self, drive: FloatArray, sample_period_s: float,
                  rest: float | None = None) -> FloatArray:
        return filtered(*self._mode(), drive, sample_period_s, rest)

    @classmethod
    def within_limits(cls, values: Mapping[str, float]) -> Self:
        """Return the mode with the possible values that are nearest to some values, by name."""
        return cls(**{each.name: float(np.clip(
            values[each.name], each.metadata["low"], each.metadata["high"]))
            for each in fields(cls)})

    @classmethod
    def bounds(cls, extent: Extent) -> dict[str, tuple[float, float]]:
        """Bound the frequency to that of a mode that the samples can show."""
        return {"frequency_rad_per_s": (2.0 * np.pi / extent.duration_s,
                                        np.pi / extent.sample_period_s)}

    @classmethod
    def starts(cls, evidence: Evidence, lowest_rad_per_s: float = 0.0) -> list[Self]:
        """Start with the best of a scan over frequency, from the lowest one, and damping."""
        low_hz = max(LOWEST_PERIODS / evidence.duration_s, lowest_rad_per_s / (2.0 * np.pi))
        high_hz = 0.2 / evidence.sample_period_s
        if low_hz >= high_hz:
            return []
        points = min(60, 1 + round(12 * np.log2(high_hz / low_hz)))
        shapes = [
            cls(2.0 * np.pi * frequency_hz, damping_ratio, 1.0)
            for frequency_hz in np.geomspace(low_hz, high_hz, points)
            for damping_ratio in SCANNED_DAMPING_RATIOS
        ]
        found = evidence.best(
            shapes,
            lambda shape: (shape._response(evidence.drive_um, evidence.sample_period_s)
                           - evidence.displacement_um)[:, None],
            count=3,
        )
        return [
            cls(shape.frequency_rad_per_s, shape.damping_ratio, float(np.clip(gains[0], -2, 3)))
            for shape, gains in found
        ]

    @classmethod
    def lacks_excitation(cls, evidence: Evidence) -> str | None:
        """Require fast motion, as slow motion does not excite a mode."""
        fast_um = np.diff(evidence.displacement_um, 2)
        if np.sqrt(np.mean(fast_um**2)) < 1e-2 * evidence.noise_um:
            return "the displacement has nothing fast that could make a mode ring"
        return None
