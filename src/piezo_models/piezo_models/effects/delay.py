# SPDX-License-Identifier: BSD-3-Clause
"""Dead time."""

from dataclasses import dataclass
from typing import ClassVar

import control
import numpy as np
from scipy.interpolate import CubicSpline

from piezo_models.effects.effect import Effect, parameter
from piezo_models.effects.filtering import slowed

PADE_ORDER = 3
"""Exact to 0.1 degree up to a phase of 90 degrees."""

LONGEST = 0.1
"""Part of a recording."""


@dataclass(frozen=True)
class Delay(Effect):
    """Everything arrives later by the same time."""

    name: ClassVar[str] = "delay"
    place: ClassVar[str] = "displacement"
    experiment: ClassVar[str] = "dynamics: steps, or tones up to the highest frequency of interest"

    delay_s: float = parameter("s", "linear", 0.0, 10.0)

    def apply(self, signal, sample_period_s, rest=None):
        """See `Effect.apply`."""
        rest = signal[0] if rest is None else rest
        whole, part = divmod(self.delay_s / sample_period_s, 1.0)
        whole = min(int(whole), signal.size)
        at = _later(signal, whole, rest)
        if part == 0.0 or signal.size < 4:
            return at
        after, earlier, earliest = (
            _later(signal, whole + samples, rest) for samples in (-1, 1, 2)
        )
        # Lagrange's cubic through the four samples around the instant.
        x = 1.0 - part
        return (
            -earliest * x * (x - 1.0) * (x - 2.0) / 6.0
            + earlier * (x + 1.0) * (x - 1.0) * (x - 2.0) / 2.0
            - at * (x + 1.0) * x * (x - 2.0) / 2.0
            + after * (x + 1.0) * x * (x - 1.0) / 6.0
        )

    def compensate(self, wanted, sample_period_s):
        """The period, earlier."""
        phase = np.arange(wanted.size + 1)
        spline = CubicSpline(phase, np.append(wanted, wanted[0]), bc_type="periodic")
        return spline((phase[:-1] + self.delay_s / sample_period_s) % wanted.size)

    def lag(self):
        """See `Effect.lag`."""
        unit = control.pade(1.0, PADE_ORDER)
        return slowed(*unit, self.delay_s) if self.delay_s > 0.0 else None

    @classmethod
    def bounds(cls, extent):
        """See `Effect.bounds`."""
        return {"delay_s": (0.0, LONGEST * extent.duration_s)}

    @classmethod
    def starts(cls, evidence):
        """Of least squares: a short delay takes off the velocity times it."""
        velocity = np.gradient(evidence.displacement_um, evidence.sample_period_s)
        gains, _ = evidence.reduction(-velocity[:, None])
        delay_s = float(np.clip(gains[0], 0.0, LONGEST * evidence.duration_s))
        return [cls(delay_s), cls(2.0 * delay_s)] if delay_s > 0.0 else []

    @classmethod
    def lacks_excitation(cls, evidence):
        """A delay shows in motion."""
        step_um = np.sqrt(np.mean(np.diff(evidence.displacement_um) ** 2))
        if step_um < 0.01 * evidence.noise_um:
            return "the displacement moves too slowly for a delay to show"
        return None


def _later(signal, samples, rest):
    """The signal some samples later; one sample earlier by going on at the end as it bends."""
    if samples < 0:
        return np.append(signal[1:], 3.0 * (signal[-1] - signal[-2]) + signal[-3])
    samples = min(samples, signal.size)
    return np.concatenate([np.full(samples, rest), signal[: signal.size - samples]])
