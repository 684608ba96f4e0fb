# SPDX-License-Identifier: BSD-3-Clause
"""What each method reaches at equal robustness, over the error of the light mode."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from piezo_controller.feedback.feedback_design import FeedbackController, UnstableLoop
from piezo_controller.feedback.sample_rate.classical_candidates import CANDIDATES
from piezo_controller.feedback.sample_rate.fast_design import (
    H_INFINITY,
    METHODS,
    Demands,
    design_at_sample_rate,
)
from piezo_models.cascade import StageModel

LIGHT_MODE_ERRORS = (0.05, 0.10, 0.20)
PEAKS = (4.0,)
"""Worst peak sensitivities, at each of which designs are compared."""

TITLES = {H_INFINITY: "H-infinity", **{name: candidate.title
                                       for name, candidate in CANDIDATES.items()}}


@dataclass(frozen=True)
class Compared:
    """A design at one robustness; `controller` is None where no stable one was found."""

    method: str
    light_mode_error: float
    worst_peak: float
    controller: FeedbackController | None

    @property
    def keeps_bounds(self) -> bool:
        """Tell whether peak and noise are within their bounds; the search may end beyond them."""
        if self.controller is None:
            return False
        report = self.controller.report
        demands = report["demands"]
        return (report["figures"]["worst_peak_sensitivity"] <= 1.01 * self.worst_peak
                and report["added_noise_um"] <= demands["added_noise_um"]
                and report["noise_voltage_v"] <= 1.01 * demands["noise_voltage_v"])


def compare(model: StageModel, take: Callable[[Compared], None], effort: float = 1.0) -> None:
    """Design with every method, at every robustness.

    Parameters
    ----------
    model : piezo_models.cascade.StageModel
    take : callable
        Is given every design.
    effort : float
        See `design_at_sample_rate`.
    """
    for worst_peak in PEAKS:
        for error in LIGHT_MODE_ERRORS:
            demands = Demands(worst_peak_sensitivity=worst_peak)
            demands = replace(demands, errors=replace(demands.errors, light_mode=error))
            for method in METHODS:
                try:
                    controller = design_at_sample_rate(model, demands, method, effort=effort)
                except UnstableLoop:
                    controller = None
                take(Compared(method, error, worst_peak, controller))
