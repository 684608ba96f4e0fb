# SPDX-License-Identifier: BSD-3-Clause
"""What a multisine with lines left out says of the cause before any effect is fitted.

An error at the excited lines alone has a linear cause. An error at odd lines that were left out is
odd distortion, that of a symmetric cause such as play or a cubic spring; at even lines it is even
distortion, that of an asymmetric one.
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


@dataclass(frozen=True)
class EvidenceSettings:
    """When distortion decides between causes.

    Attributes
    ----------
    absent : float
        Part of the linear error below which distortion must lie to count as absent. A spring or a
        sensor that is curved over the range has its linear part and its distortion within a factor
        of ten over the quarter of the range that the experiment moves; a play has more.
    """

    absent: float = 0.02


SETTINGS = EvidenceSettings()

NEGLIGIBLE = 1e-3
"""Part of the answer that a good model may be wrong by."""


@dataclass(frozen=True)
class ErrorDistortion:
    """The answer of a stage to an odd multisine, and the error of a model of it.

    Attributes
    ----------
    answer, error : NonlinearDistortion
        Of the measured displacement, and of measured minus simulated.
    """

    answer: NonlinearDistortion
    error: NonlinearDistortion

    def shown(self) -> frozenset[str]:
        """Return which of "linear", "even" and "odd" the error has, beyond noise and rounding."""
        parts = {"linear": self.error.linear_um, "even": self.error.even_um,
                 "odd": self.error.odd_um}
        least_um = max(self.error.significant_um, NEGLIGIBLE * self.answer.answer_um)
        return frozenset(name for name, part_um in parts.items() if part_um > least_um
                         and not (name != "linear" and self.is_absent(name)))

    def is_absent(self, kind: str) -> bool:
        """Return whether distortion is so small beside the linear error that its cause has none.

        Parameters
        ----------
        kind : str
            "even" or "odd".
        """
        part_um = {"even": self.error.even_um, "odd": self.error.odd_um}[kind]
        most_um = max(part_um, self.error.significant_um)
        return most_um < SETTINGS.absent * self.error.linear_um

    def sentence(self) -> str:
        """Tell what the error is made of, and of which causes that speaks."""
        answer_um = self.answer.answer_um
        parts = ", ".join(f"{name} {100.0 * part_um / answer_um:.3g} %" for name, part_um in (
            ("linear", self.error.linear_um), ("even", self.error.even_um),
            ("odd", self.error.odd_um), ("noise of a period", self.error.noise_of_period_um)))
        return f"Error of the model over the answer: {parts}. {self._speaks_of()}."

    def _speaks_of(self) -> str:
        shown = self.shown()
        if not shown:
            return "The model lacks nothing that the multisine shows"
        if shown == {"linear"}:
            return "No distortion is left: the cause is linear"
        if "even" not in shown:
            return "The distortion is odd alone: the cause is symmetric, such as play"
        if "odd" not in shown:
            return "The distortion is even alone: the cause is asymmetric"
        return "The distortion is even and odd: the cause is nonlinear and not symmetric"


def error_distortion(part: SimulatedRecording, residual_um: FloatArray) -> ErrorDistortion | None:
    """Separate the error of a model into linear error, even and odd distortion, and noise.

    Parameters
    ----------
    residual_um : ndarray, shape (N,)
        Measured minus simulated.

    Returns
    -------
    ErrorDistortion or None
        None where the voltage is no repeated multisine with odd and even lines left out.
    """
    answer = distortion_of_signal(part.voltage_v, part.measured_um, part.sample_period_s)
    # A delay passes the distortion of the hysteresis on, and is linear all the same.
    error = distortion_of_signal(
        part.voltage_v, residual_um, part.sample_period_s, part.simulate())
    return None if answer is None or error is None else ErrorDistortion(answer, error)


def excluded_by_distortion(parts: Sequence[SimulatedRecording],
                           kinds: Sequence[type[Effect]]) -> dict[str, str]:
    """Return the effects that the error of a model rules out by the distortion it lacks, and why.

    Parameters
    ----------
    kinds : sequence of type
        Effects.

    Returns
    -------
    dict of str to str
        Reasons by the name of the effect; empty without an odd multisine among the recordings.
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
