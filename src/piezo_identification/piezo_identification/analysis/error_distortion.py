# SPDX-License-Identifier: BSD-3-Clause
"""Narrow down the cause of a model error with a multisine that omits lines, before any fit.

An error only at the excited lines has a linear cause. An error at omitted odd lines is odd
distortion, which has a symmetric cause such as play or a cubic spring. An error at even lines is
even distortion, which has an asymmetric cause.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from piezo_common.arrays import FloatArray
from piezo_identification.analysis.nonlinear_distortion import (
    NonlinearDistortion,
    distortion_of_signal,
)
from piezo_identification.simulation.simulated_recording import SimulatedRecording
from piezo_models.effects import Effect

ABSENT = 0.02
"""Fraction of the linear error below which distortion counts as absent. A spring or sensor with a
curved characteristic has distortion of at least a tenth of its linear error over the quarter of the
range that the experiment uses; play has more."""

NEGLIGIBLE = 1e-3
"""Error that is acceptable for a good model, as a fraction of the response."""


@dataclass(frozen=True)
class ErrorDistortion:
    """The response of a stage to an odd multisine, and the error of a model."""

    answer: NonlinearDistortion
    error: NonlinearDistortion
    """Distortion of the measured displacement, and of measured minus simulated displacement."""

    def shown(self) -> frozenset[str]:
        """Return those of "linear", "even" and "odd" that the error contains significantly."""
        parts = {"linear": self.error.linear_um, "even": self.error.even_um,
                 "odd": self.error.odd_um}
        least_um = max(self.error.significant_um, NEGLIGIBLE * self.answer.answer_um)
        return frozenset(name for name, part_um in parts.items() if part_um > least_um
                         and not (name != "linear" and self.is_absent(name)))

    def is_absent(self, kind: str) -> bool:
        """Return whether "even" or "odd" distortion is so small that the linear cause has none."""
        part_um = {"even": self.error.even_um, "odd": self.error.odd_um}[kind]
        most_um = max(part_um, self.error.significant_um)
        return most_um < ABSENT * self.error.linear_um

    def sentence(self) -> str:
        """Describe the parts of the error and the causes that they indicate."""
        answer_um = self.answer.answer_um
        parts = ", ".join(f"{name} {100.0 * part_um / answer_um:.3g} %" for name, part_um in (
            ("linear", self.error.linear_um), ("even", self.error.even_um),
            ("odd", self.error.odd_um), ("noise of a period", self.error.noise_of_period_um)))
        return f"Error of the model over the answer: {parts}. {self._speaks_of()}."

    def _speaks_of(self) -> str:
        shown = self.shown()
        if not shown:
            return "The multisine shows no missing effect"
        if shown == {"linear"}:
            return "No distortion remains: the cause is linear"
        if "even" not in shown:
            return "The distortion is odd alone: the cause is symmetric, such as play"
        if "odd" not in shown:
            return "The distortion is even alone: the cause is asymmetric"
        return "The distortion is even and odd: the cause is nonlinear and not symmetric"


def error_distortion(part: SimulatedRecording, residual_um: FloatArray) -> ErrorDistortion | None:
    """Separate the error of a model into linear error, even and odd distortion, and noise.

    It is None if the voltage is not a repeated multisine that omits odd and even lines.
    """
    answer = distortion_of_signal(part.voltage_v, part.measured_um, part.sample_period_s)
    # A linear cause such as a delay also acts on the distortion of the hysteresis.
    error = distortion_of_signal(
        part.voltage_v, residual_um, part.sample_period_s, part.simulate())
    return None if answer is None or error is None else ErrorDistortion(answer, error)


def excluded_by_distortion(parts: Sequence[SimulatedRecording],
                           kinds: Sequence[type[Effect]]) -> dict[str, str]:
    """Return why effects are excluded: the error lacks their distortion.

    Nothing is excluded without an odd multisine among the recordings.
    """
    excluded: dict[str, str] = {}
    for part in parts:
        found = error_distortion(part, part.measured_um - part.simulate())
        if found is None:
            continue
        absent = {kind for kind in ("even", "odd") if found.is_absent(kind)}
        for kind in kinds:
            if kind.distortion and kind.distortion <= absent:
                missing = " or ".join(sorted(kind.distortion))
                excluded[kind.name] = f"the multisine shows no {missing} distortion"
    return excluded
