# SPDX-License-Identifier: BSD-3-Clause
"""Stiffness that changes with the displacement."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from piezo_models.effects.effect import Effect, parameter
from piezo_models.effects.filtering import filtered

FORCE_ROUNDS = 3
"""The force follows from the displacement that it changes."""


@dataclass(frozen=True)
class Stiffening(Effect):
    """A spring whose force has parts up to the fourth power beside a linear one.

    The parts are given as the displacement that they take off at the ends of the range. They are
    forces: what they take off passes the mode of the spring once more, and is largest where the
    mode is near.
    """

    name: ClassVar[str] = "stiffening"
    place: ClassVar[str] = "displacement"
    experiment: ClassVar[str] = "hysteresis: harmonics over the whole range, and large fast tones"

    linear_um: float = parameter("um")
    square_um: float = parameter("um")
    cubic_um: float = parameter("um")
    centre_um: float = parameter("um", "fixed")
    half_range_um: float = parameter("um", "fixed", 1e-12, 1e9)
    frequency_rad_per_s: float = parameter("rad/s", "fixed", 0.0, 1e9)
    damping_ratio: float = parameter("1", "fixed", 0.0, 10.0)
    quartic_um: float = parameter("um", default=0.0)

    def yields(self, signal, sample_period_s, rest=None):
        """What each part of 1 um at the ends would take off, shape (N, 4)."""
        def forces(level):
            x = np.clip((level - self.centre_um) / self.half_range_um, -1.5, 1.5)
            return np.column_stack([x, x**2, x**3, x**4])

        parts = forces(signal)
        if self.frequency_rad_per_s == 0.0:
            return parts
        w = self.frequency_rad_per_s
        before = forces(np.array([signal[0] if rest is None else rest]))[0]
        return np.column_stack([
            filtered([w * w], [1.0, 2.0 * self.damping_ratio * w, w * w], part, sample_period_s,
                     level)
            for part, level in zip(parts.T, before, strict=True)
        ])

    def apply(self, signal, sample_period_s, rest=None):
        """See `Effect.apply`."""
        bent = signal
        for _ in range(FORCE_ROUNDS):
            bent = signal - self.yields(bent, sample_period_s, rest) @ (
                self.linear_um, self.square_um, self.cubic_um, self.quartic_um
            )
        return bent

    @classmethod
    def starts(cls, evidence):
        """Least squares, for each mode of the model, and for a spring that acts at once."""
        low, high = evidence.displacement_um.min(), evidence.displacement_um.max()
        if low == high:
            return []
        dynamics = evidence.dynamics
        modes = zip(dynamics.mode_frequencies_rad_per_s, dynamics.damping_ratios, strict=True)
        # Faster than the samples a mode follows at once.
        modes = [mode for mode in modes if mode[0] * evidence.sample_period_s <= 1.0]
        starts = []
        for mode in (*modes, (0.0, 1.0)):
            shape = cls(0.0, 0.0, 0.0, 0.5 * (low + high), 0.5 * (high - low), *mode)
            gains, _ = evidence.reduction(
                -shape.yields(evidence.displacement_um, evidence.sample_period_s)
            )
            *lower, quartic_um = gains
            starts.append(
                cls(*lower, shape.centre_um, shape.half_range_um, *mode, quartic_um=quartic_um))
        return starts
