# SPDX-License-Identifier: BSD-3-Clause
"""Design of a feedback at the rate of the sample clock, with a bandwidth above the first mode.

It is the robust controller of fixed order, with resonances at the disturbances, that has the
largest margin to the requirements over all stages; see `tuned_over_stages`.
"""

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import control
import numpy as np

from piezo_controller.feedback.feedback_design import (
    FeedbackController,
    UnstableLoop,
    feedback_from_control,
)
from piezo_controller.feedback.sample_rate.demands import Demands
from piezo_controller.feedback.sample_rate.perturbed_loops import PerturbedLoops
from piezo_controller.feedback.sample_rate.tuned_over_stages import tuned_family
from piezo_models.cascade import StageModel

METHOD = "fixed_order_resonant"


def design_at_sample_rate(model: StageModel, demands: Demands | None = None,
                          clock_period_s: float = 25e-6,
                          effort: float = 1.0) -> FeedbackController:
    """Design a feedback that answers every sample, for a model with a mode and no antiresonances.

    It answers a sample by the next one, as a stage that evaluates it by itself. The effort is a
    factor on the number of controllers that are tried. For the report see `measured_design`. Raises
    `UnstableLoop` if no controller was found that is stable with every stage, and ValueError for
    another model.
    """
    check_modes(model)
    demands = demands or Demands()
    loops = demands.loops(model, clock_period_s)
    family = tuned_family(model, demands, clock_period_s)
    numbers = family.search(loops, demands, effort)
    return measured_design(family.controller(numbers), model, demands, loops, METHOD,
                           family.report(numbers))


def check_modes(model: StageModel) -> None:
    """Raise ValueError if a model has no mode or has antiresonances."""
    if not model.dynamics.damping_ratios or model.dynamics.antiresonance_damping_ratios:
        raise ValueError("the model has no mode, or has antiresonances: a feedback at the sample "
                         "rate is designed for modes without them")


def measured_design(controller: control.StateSpace, model: StageModel, demands: Demands,
                    loops: PerturbedLoops, method: str, own: Mapping[str, Any],
                    model_sha256: str = "") -> FeedbackController:
    """Return a controller at the rate of the sample clock, with its performance in its report.

    In addition to what `feedback_from_control` reports, its report holds ``demands``, ``figures``
    (`LoopFigures`), ``margin_db``, ``added_noise_um``, ``noise_voltage_v`` and the `own` entries of
    the method. Raises `UnstableLoop` if it is not stable with every stage.
    """
    figures = loops.measure(controller)
    if figures.unstable:
        raise UnstableLoop(
            f"no controller of the method {method} was found that is stable with all "
            f"{len(loops.plants)} stages: lower the errors or the demands, or raise the effort")
    designed = feedback_from_control(
        controller, model, controller.dt, model_sha256, method, delay_ticks=0)
    first_mode_hz = min(model.dynamics.mode_frequencies_rad_per_s) / (2 * np.pi)
    noise_um = demands.sensor_noise_um
    return replace(designed, report={
        **designed.report, "demands": asdict(demands), "figures": asdict(figures),
        "margin_db": demands.margin_db(figures, first_mode_hz),
        "added_noise_um": noise_um * figures.noise_gain,
        "noise_voltage_v": noise_um * figures.noise_gain_v_per_um, **own})
