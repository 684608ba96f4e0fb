# SPDX-License-Identifier: BSD-3-Clause
"""Stiffness that changes with displacement."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_models.effects.effect import LEAST, MOST, Effect, Evidence, Extent, parameter
from piezo_models.effects.filtering import filtered
from piezo_models.effects.spring_equation import FARTHEST, SOFTEST, balance, straight_beyond

STRONGEST = 100.0
"""Largest force of a part at the end of the range, over that of the linear spring."""

UNRESOLVED = 20.0
"""Angle in rad of the mode between two samples from which it is taken as static: recordings do not
show it, and simulating it for minutes would take minutes."""


LEAST_VISCOUS, MOST_VISCOUS = -1.0, 10.0
"""Bounds of the additional damping, which is twice a damping ratio: the lower one removes half of
the critical damping."""


@dataclass(frozen=True)
class Stiffening(Effect):
    """A spring whose force has parts up to the fourth power in addition to a linear one.

    Each part f is given as the displacement by which it would shorten the linear spring at the ends
    of the range. With the displacement x of the linear spring and the spring's mode G of frequency
    w, the displacement y is the solution of y = x - G (f(y) + viscous y'/w), for any size of f. The
    linear part of f and the viscous part correct the frequency and damping of a mode that was
    identified without the spring. The force is a straight line beyond `spring_equation.FARTHEST`
    half ranges, or where the spring would be softer than `spring_equation.SOFTEST` of the linear
    one.
    """

    name: ClassVar[str] = "stiffening"
    place: ClassVar[str] = "displacement"
    experiment: ClassVar[str] = "hysteresis: harmonics over the whole range, and large fast tones"
    distortion: ClassVar[frozenset[str] | None] = frozenset({"even", "odd"})
    confounded_with: ClassVar[tuple[str, ...]] = ("sensor_nonlinearity",)

    linear_um: float = parameter("um")
    square_um: float = parameter("um")
    cubic_um: float = parameter("um")
    centre_um: float = parameter("um", "fixed")
    half_range_um: float = parameter("um", "fixed", LEAST, MOST)
    frequency_rad_per_s: float = parameter("rad/s", "fixed", 0.0, MOST)
    damping_ratio: float = parameter("1", "fixed", 0.0, MOST)
    quartic_um: float = parameter("um", default=0.0)
    viscous: float = parameter("1", "linear", LEAST_VISCOUS, MOST_VISCOUS, default=0.0)

    @property
    def _parts(self) -> tuple[float, float, float, float]:
        return self.linear_um, self.square_um, self.cubic_um, self.quartic_um

    def yields(self, signal: FloatArray, sample_period_s: float) -> FloatArray:
        """Return what each part of 1 um at the ends removes from a displacement, shape (N, 4)."""
        x = np.clip((signal - self.centre_um) / self.half_range_um, -FARTHEST, FARTHEST)
        parts = np.column_stack([x, x**2, x**3, x**4])
        if self.frequency_rad_per_s == 0.0:
            return parts
        w = self.frequency_rad_per_s
        return np.column_stack([
            filtered([w * w], [1.0, 2.0 * self.damping_ratio * w, w * w], part, sample_period_s)
            for part in parts.T])

    def _damped(self, signal: FloatArray, sample_period_s: float) -> FloatArray:
        """Return what an additional damping of 1 removes, shape (N, 1); (N, 0) without a mode."""
        if self.acts_at_once(sample_period_s):
            return np.empty((signal.size, 0))
        w = self.frequency_rad_per_s
        return filtered([w, 0.0], [1.0, 2.0 * self.damping_ratio * w, w * w], signal,
                        sample_period_s)[:, None]

    def apply(self, signal: FloatArray, sample_period_s: float,
              rest: float | None = None) -> FloatArray:
        """Return the solution of the spring's equation of motion for the signal as its load."""
        return balance(
            signal, self._parts, self.viscous, self.centre_um, self.half_range_um,
            0.0 if self.acts_at_once(sample_period_s) else self.frequency_rad_per_s,
            self.damping_ratio, sample_period_s, signal[0] if rest is None else rest,
        )

    def acts_at_once(self, sample_period_s: float) -> bool:
        """Return True if the spring has no mode, or one that is too fast for the samples."""
        turned = self.frequency_rad_per_s * sample_period_s
        return turned == 0.0 or turned >= UNRESOLVED

    @classmethod
    def bounds(cls, extent: Extent) -> dict[str, tuple[float, float]]:
        """Bound the parameters by what the recordings can show."""
        strongest_um = STRONGEST * extent.travel_um
        parts = ("linear_um", "square_um", "cubic_um", "quartic_um")
        return {name: (-strongest_um, strongest_um) for name in parts}

    def impossible(self, extent: Extent) -> str | None:
        """Reject a spring that is too soft within the range, or whose small vibrations grow."""
        if self.frequency_rad_per_s and 2.0 * self.damping_ratio + self.viscous < 0.0:
            return "the mode would gain energy in small vibrations"
        if np.abs(straight_beyond(self._parts, self.half_range_um)).min() < 1.0:
            return (f"the spring would be softer than {100 * SOFTEST:g} % of its stiffness within "
                    "the range")
        return None

    @classmethod
    def starts(cls, evidence: Evidence) -> list[Self]:
        """Start with least squares for each mode of the model.

        The spring's equation is linear in its parts for the measured displacement. A spring without
        a mode would be indistinguishable from a curved sensor, so it is tried only for a model
        without modes.
        """
        low, high = evidence.displacement_um.min(), evidence.displacement_um.max()
        if evidence.travel_um == 0.0:
            return []
        dynamics = evidence.dynamics
        modes = list(zip(
            dynamics.mode_frequencies_rad_per_s, dynamics.damping_ratios, strict=True))
        measured_um = evidence.displacement_um + evidence.residual_um
        starts = []
        for mode in modes or [(0.0, 1.0)]:
            shape = cls(0.0, 0.0, 0.0, 0.5 * (low + high), 0.5 * (high - low), *mode)
            parts = shape.yields(measured_um, evidence.sample_period_s)
            damped = shape._damped(measured_um, evidence.sample_period_s)
            gains, _ = evidence.reduction(-np.column_stack([parts, damped]))
            linear_um, square_um, cubic_um, quartic_um, *viscous = gains.tolist()
            starts.append(cls(linear_um, square_um, cubic_um, shape.centre_um, shape.half_range_um,
                              *mode, quartic_um,
                              *np.clip(viscous, LEAST_VISCOUS, MOST_VISCOUS).tolist()))
        return starts
