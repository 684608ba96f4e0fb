# SPDX-License-Identifier: BSD-3-Clause
"""A mode whose part of the displacement is out of phase with that of the others."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import mul
from typing import ClassVar, Self

import control
import numpy as np
from numpy.polynomial import Polynomial

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_models.effects.effect import Evidence, parameter
from piezo_models.effects.filtering import filtered
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.linear.dynamics import ElectricVibrationDynamics

ROUNDING = 1e-12
"""Size, relative to the largest one, below which a coefficient of a polynomial is rounding."""


@dataclass(frozen=True)
class CoupledMode(VibrationMode):
    """A pair of poles with any residue: (p + v s / w) / (1 + 2 d s / w + (s / w)^2).

    Any proper rational dynamics behind a lag is a sum of these and a direct part. Modes of a
    structure have real participations. Modes that are coupled by a damper, an amplifier of higher
    order or another lag also have a part v that follows the velocity. A pair with a damping ratio
    above 1 is two relaxations.
    """

    name: ClassVar[str] = "coupled_mode"
    experiment: ClassVar[str] = VibrationMode.experiment
    confounded_with: ClassVar[tuple[str, ...]] = ("vibration_mode",)

    damping_ratio: float = parameter("1", "logarithm", 1e-5, 100.0)
    participation: float = parameter("1", "linear", -1e3, 1e3)
    velocity_participation: float = parameter("1", "linear", -1e3, 1e3, default=0.0)

    def _parts(self) -> tuple[float, float]:
        return self.participation, self.velocity_participation

    def branch(self) -> control.StateSpace:
        """Return the continuous system of the mode's contribution to the displacement."""
        return self._system(*self._parts())

    def apply(self, signal: FloatArray, sample_period_s: float,
              rest: float | None = None) -> FloatArray:
        """Return the signal behind the mode if it is the only one."""
        w = self.frequency_rad_per_s
        branch = filtered([self.velocity_participation * w, self.participation * w * w],
                          self._mode()[1], signal, sample_period_s, rest)
        return (1.0 - self.participation) * signal + branch

    @classmethod
    def starts(cls, evidence: Evidence, lowest_rad_per_s: float = 0.0) -> list[Self]:
        """Return none: `identify` finds these modes together with the dynamics."""
        return []


def modes_in_parallel(dynamics: ElectricVibrationDynamics) -> tuple[CoupledMode, ...]:
    """Return parallel modes that are equivalent to modes in series with antiresonances.

    Behind the electric lag of the dynamics their sum is the same transfer function (4.3), by
    partial fractions. There are more modes than antiresonances, and none is critically damped.
    Raises ValueError if two modes are so close to each other that their parts are out of bounds.
    """
    frequencies, dampings = (np.array(each) for each in (
        dynamics.mode_frequencies_rad_per_s, dynamics.damping_ratios))
    roots = np.sqrt(dampings.astype(complex) ** 2 - 1.0)
    poles = frequencies * np.array([-dampings + roots, -dampings - roots])

    def factor(s: ComplexArray, frequency: float, damping: float) -> ComplexArray:
        return 1.0 + 2.0 * damping * s / frequency + (s / frequency) ** 2

    at_poles = np.ones_like(poles)
    for zero in zip(dynamics.antiresonance_frequencies_rad_per_s,
                    dynamics.antiresonance_damping_ratios, strict=True):
        at_poles *= factor(poles, *zero)
    for number, mode in enumerate(zip(frequencies, dampings, strict=True)):
        others = np.arange(frequencies.size) != number
        at_poles[:, others] /= factor(poles[:, others], *mode)
    velocity = (at_poles[0] - at_poles[1]) * frequencies / (poles[0] - poles[1])
    position = at_poles[0] - velocity * poles[0] / frequencies
    return tuple(CoupledMode(*map(float, numbers)) for numbers in zip(
        frequencies, dampings, position.real, velocity.real, strict=True))


def modes_in_series(modes: Sequence[VibrationMode],
                    most_rad_per_s: float) -> tuple[ElectricVibrationDynamics, float] | None:
    """Return parallel modes in series with their antiresonances, and the lead of their other zeros.

    The inverse of `modes_in_parallel` up to zeros that are real or faster than `most_rad_per_s`,
    which no antiresonance describes: for slow signals they are a lead, in s. Return None if a pair
    of zeros is in the right half-plane.
    """
    # Rates relative to a common one keep the coefficients of the same magnitude.
    unit = float(np.exp(np.mean(np.log([mode.frequency_rad_per_s for mode in modes]))))
    scales = [unit / mode.frequency_rad_per_s for mode in modes]
    poles = [Polynomial([1.0, 2.0 * mode.damping_ratio * scale, scale**2])
             for mode, scale in zip(modes, scales, strict=True)]
    parts = [mode._parts() for mode in modes]
    direct = 1.0 - sum(position for position, _ in parts)
    zeros = _product([Polynomial([direct]), *poles])
    for number, ((position, velocity), scale) in enumerate(zip(parts, scales, strict=True)):
        numerator = Polynomial([position, velocity * scale])
        zeros += _product([numerator, *poles[:number], *poles[number + 1 :]])
    zeros = zeros.trim(float(ROUNDING * np.abs(zeros.coef).max()))
    roots = unit * np.asarray(zeros.roots(), dtype=complex)
    pairs = roots[(roots.imag > 0.0) & (np.abs(roots) < most_rad_per_s)]
    if np.any(pairs.real >= 0.0):
        return None
    others = roots[(roots.imag == 0.0) | (np.abs(roots) >= most_rad_per_s)]
    return ElectricVibrationDynamics(
        0.0, tuple(mode.frequency_rad_per_s for mode in modes),
        tuple(mode.damping_ratio for mode in modes),
        tuple(np.abs(pairs).tolist()),
        tuple((-pairs.real / np.abs(pairs)).tolist())), float(-np.sum(1.0 / others).real)


def _product(factors: Sequence[Polynomial]) -> Polynomial:
    return reduce(mul, factors, Polynomial([1.0]))
