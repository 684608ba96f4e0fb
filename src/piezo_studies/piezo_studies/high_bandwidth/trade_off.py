# SPDX-License-Identifier: BSD-3-Clause
"""Compare the methods at equal robustness for several errors of the light mode."""

import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path

from piezo_controller.feedback.controller_file import load_controller, save_controller
from piezo_controller.feedback.feedback_design import FeedbackController, UnstableLoop
from piezo_controller.feedback.sample_rate.classical_forms import FORMS
from piezo_controller.feedback.sample_rate.demands import Demands
from piezo_controller.feedback.sample_rate.fast_design import METHOD
from piezo_controller.feedback.sample_rate.searched_designs import H_INFINITY, design_by
from piezo_controller.feedback.synthesis.generalised_plant import nominal_hysteresis_gain
from piezo_models.cascade import StageModel

DEMANDS = Demands(noise_voltage_v=3.3, slow_sensitivity=4.0)
"""Demands of the comparison, with weaker bounds than the defaults of `design_at_sample_rate`.
docs/high_bandwidth.md states them."""

LIGHT_MODE_ERRORS = (0.05, 0.10, 0.15, 0.20)

OF_EVERY_STAGE = ((True, 0.20, METHOD),)
"""Further designs that must meet the demands for every stage, at the largest error."""

TITLES = {METHOD: "fixed order with resonances at 50 Hz and 100 Hz", H_INFINITY: "H-infinity",
          **{name: FORMS[name].title for name in (
              "notch_pi", "integral_resonant", "positive_position", "inverse_pi")}}
"""Titles of the compared methods."""


@dataclass(frozen=True)
class Compared:
    """A design for one error of the light mode; `controller` is None if no stable one was found."""

    method: str
    light_mode_error: float
    of_every_stage: bool
    controller: FeedbackController | None

    @property
    def keeps_bounds(self) -> bool:
        """Whether peak and noise are within their bounds, which a search may exceed."""
        if self.controller is None:
            return False
        report = self.controller.report
        demands = report["demands"]
        return (report["figures"]["worst_peak_sensitivity"]
                <= 1.01 * demands["worst_peak_sensitivity"]
                and report["added_noise_um"] <= demands["added_noise_um"]
                and report["noise_voltage_v"] <= 1.01 * demands["noise_voltage_v"])


def compare(model: StageModel, take: Callable[[Compared], None], kept: Path,
            effort: float = 1.0) -> None:
    """Design with every method for every error of the light mode.

    Parameters
    ----------
    kept : pathlib.Path
        Directory of controller files; a saved design for the same demands is used again.
    effort : float
        Passed to `design_by`.
    """
    for of_every_stage, error, method in (*product((False,), LIGHT_MODE_ERRORS, TITLES),
                                          *OF_EVERY_STAGE):
        demands = replace(DEMANDS, of_every_stage=of_every_stage,
                          errors=replace(DEMANDS.errors, light_mode=error))
        path = kept / (f"{method}_{100 * error:.0f}_"
                       f"{'every_stage' if of_every_stage else 'model'}.json")
        controller = _same_design(path, model, demands)
        if controller is None:
            with suppress(UnstableLoop):
                controller = design_by(method, model, demands, effort=effort)
                save_controller(path, controller)
        take(Compared(method, error, of_every_stage, controller))


def _same_design(path: Path, model: StageModel, demands: Demands) -> FeedbackController | None:
    """Return the controller of a file if it was designed for the same demands; None otherwise."""
    if not path.exists():
        return None
    controller = load_controller(path)
    gain_um_per_v = nominal_hysteresis_gain(model)
    same = (controller.report.get("demands") == json.loads(json.dumps(asdict(demands)))
            and controller.hysteresis_gain_um_per_v == gain_um_per_v)
    return controller if same else None
