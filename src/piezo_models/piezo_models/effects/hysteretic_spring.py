# SPDX-License-Identifier: BSD-3-Clause
"""Hysteresis inside the mechanics: a spring whose force depends on its past motion."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import ClassVar, Self

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_models.effects.bouc_wen_equation import NEW_STATE, force_under, substeps_of, swing
from piezo_models.effects.effect import LEAST, MOST, Evidence, parameter
from piezo_models.effects.filtering import filtered
from piezo_models.effects.swinging_mode import SwingingMode

SCANNED_BETAS = (0.3, 1.0, 3.0)
SCANNED_GAMMAS = (-1.0, -0.5, 0.0, 1.0)
"""Factors of beta. If the forces of the middle beta together remove too little, no other one is
tried."""

PERIODS_TO_REPEAT = 10
"""Periods after which the hysteresis no longer depends on its initial state."""

LEAST_SPEED = 0.2
"""Smallest maximum speed, over the RMS displacement times the frequency of the mode, at which the
motion is not quasi-static."""

LEAST_SHARE = 0.05
"""The hysteresis must remove at least this fraction of the residual that a linear change of the
mode leaves, or it is not fitted: each fit solves the equation of motion dozens of times."""


@dataclass(frozen=True)
class HystereticSpring(SwingingMode):
    """A spring with Bouc-Wen hysteresis, parallel to the linear spring of a mode.

    With the displacement x of the linear spring and the spring's mode G of frequency w, the
    displacement y is the solution of y = x - G f, f = linear y + viscous y'/w + z. The force z,
    over the stiffness of the linear spring, follows Bouc and Wen with half the range h and the
    exponent n:
    ``z' = stiffness y' - (beta |y'| |z/h|^(n-1) z/h + gamma y' |z/h|^n)``.
    """

    name: ClassVar[str] = "hysteretic_spring"
    place: ClassVar[str] = "displacement"
    experiment: ClassVar[str] = "a multisine around the mode, at a small and at a large amplitude"
    distortion: ClassVar[frozenset[str] | None] = frozenset({"odd"})

    linear: float = parameter("1", "linear", -0.9, 10.0)
    viscous: float = parameter("1", "linear", -1.0, 10.0)
    stiffness: float = parameter("1", "linear", 0.0, 10.0)
    beta: float = parameter("1", "linear", 0.0, 100.0)
    gamma: float = parameter("1", "linear", -100.0, 100.0)
    exponent: float = parameter("1", "logarithm", 0.5, 4.0)
    centre_um: float = parameter("um", "fixed")
    half_range_um: float = parameter("um", "fixed", LEAST, MOST)
    frequency_rad_per_s: float = parameter("rad/s", "fixed", LEAST, MOST)
    damping_ratio: float = parameter("1", "fixed", 0.0, MOST)

    def _at_rest(self, level: float) -> FloatArray:
        state = np.zeros(NEW_STATE)
        state[0] = (level - self.centre_um) * self.linear / (1.0 + self.linear)
        state[3:6] = level
        return state

    def _swing(self, loads: FloatArray, state: FloatArray, phase: float) -> FloatArray:
        parts = np.array([self.linear, self.viscous, self.stiffness, self.beta, self.gamma,
                          self.exponent])
        substeps = substeps_of(phase, parts)
        return swing(loads, state, self.centre_um, self.half_range_um, parts, self.damping_ratio,
                     phase / substeps, substeps)

    def _force(self, wanted: FloatArray, derivative: ComplexArray) -> ComplexArray:
        """Return the spectrum of the force, once the hysteresis repeats."""
        away_um = wanted - self.centre_um
        hysteretic = force_under(
            np.tile(away_um, PERIODS_TO_REPEAT), self.half_range_um, self.stiffness, self.beta,
            self.gamma, self.exponent)[-wanted.size :]
        return ((self.linear + self.viscous * derivative) * np.fft.rfft(away_um)
                + np.fft.rfft(hysteretic))

    @classmethod
    def starts(cls, evidence: Evidence) -> list[Self]:
        """Start with the best shapes of a scan under the measured displacement.

        The removed displacement is linear in all parameters of the force except its shape. Motion
        that is slow compared with the mode gives no start, as hysteresis of the voltage is
        equivalent there.
        """
        measured_um = evidence.displacement_um + evidence.residual_um
        low, high = float(measured_um.min()), float(measured_um.max())
        centre_um, half_um = 0.5 * (low + high), 0.5 * (high - low)

        @cache
        def force(beta: float, gamma: float) -> FloatArray:
            return np.asarray(
                force_under(measured_um - centre_um, half_um, 1.0, beta, gamma, 1.0))

        found: list[tuple[float, Self]] = []
        for frequency, damping in _moved(evidence):
            shape = cls(0.0, 0.0, 1.0, 0.0, 0.0, 1.0, centre_um, half_um, frequency, damping)
            found += shape._scanned(evidence, measured_um, force)
        found.sort(key=lambda entry: -entry[0])
        return [start for _, start in found[:3]]

    def _scanned(self, evidence: Evidence, measured_um: FloatArray,
                 force: Callable[[float, float], FloatArray]) -> list[tuple[float, Self]]:
        """Return shapes whose force removes more than a change of the mode, with the removed share.

        With the exponent 1, the force of a stiffness s is s times that of a stiffness 1.
        """
        period_s, w = evidence.sample_period_s, self.frequency_rad_per_s
        mode = [1.0, 2.0 * self.damping_ratio * w, w * w]
        away_um = measured_um - self.centre_um
        changed = np.column_stack([
            filtered([w * w], mode, away_um, period_s),
            filtered([w, 0.0], mode, away_um, period_s),
        ])
        _, linear_share = evidence.reduction(-changed)
        least_share = linear_share + LEAST_SHARE * (1.0 - linear_share)

        def removed(beta: float, gamma: float) -> FloatArray:
            return filtered([w * w], mode, force(beta, gamma), period_s)

        middle = SCANNED_BETAS[len(SCANNED_BETAS) // 2]
        together = np.column_stack(
            [changed, *(removed(middle, part * middle) for part in SCANNED_GAMMAS)])
        if evidence.reduction(-together)[1] < least_share:
            return []
        found = []
        for beta, part in product(SCANNED_BETAS, SCANNED_GAMMAS):
            gamma = part * beta
            gains, share = evidence.reduction(-np.column_stack([changed, removed(beta, gamma)]))
            linear, viscous, stiffness = gains.tolist()
            if stiffness <= 0.0 or share < least_share:
                continue
            start = replace(self, linear=float(np.clip(linear, -0.9, 10.0)),
                            viscous=float(np.clip(viscous, -1.0, 10.0)),
                            stiffness=min(stiffness, 10.0), beta=beta, gamma=gamma)
            found.append((share, start))
        return found


def _moved(evidence: Evidence) -> list[tuple[float, float]]:
    """Return frequency in rad/s and damping of the modes whose motion is resolved and not slow."""
    dynamics, period_s = evidence.dynamics, evidence.sample_period_s
    size_um = float(np.std(evidence.displacement_um))
    speed_um = float(np.abs(np.diff(evidence.displacement_um)).max()) / period_s
    if size_um == 0.0:
        return []
    modes = zip(dynamics.mode_frequencies_rad_per_s, dynamics.damping_ratios, strict=True)
    return [mode for mode in modes
            if mode[0] * period_s <= 1.0 and speed_um >= LEAST_SPEED * mode[0] * size_um]
