# SPDX-License-Identifier: BSD-3-Clause
"""The work of `design`: design the controller, write, print and draw it."""

import argparse
import shlex
from hashlib import sha256
from pathlib import Path
from typing import Any

from piezo_controller.feedback.controller_file import save_controller
from piezo_controller.feedback.controller_view import REPORT_ROWS
from piezo_controller.feedback.feedback_design import (
    FeedbackController,
    structured_singular_value,
)
from piezo_controller.feedback.loop_pictures import draw_bode, draw_mu, draw_nyquist, draw_weights
from piezo_controller.feedback.loop_rules import LoopRules
from piezo_controller.feedback.robustness import Robustness, check_robustness
from piezo_controller.feedback.stage_design import CLOCK_PERIOD_S, design_for_stage
from piezo_controller.feedback.synthesis.generalised_plant import design_plant, generalised_plant
from piezo_controller.feedback.synthesis.weights import DesignWeights
from piezo_models.cascade import StageModel
from piezo_models.model_file import load_model

GAIN_SPREAD = 0.12


def design_controller(options: argparse.Namespace) -> None:
    """Design the controller of the options; write it, print its margins and draw its loop."""
    model = load_model(options.model).model
    design = design_for_stage(
        model, options.weights, options.method, options.scaling, options.disturbance_hz,
        options.samples_per_tick, options.at_once, not options.full_order, options.delay_ticks,
        sha256(options.model.read_bytes()).hexdigest())
    controller, weights = design.controller, design.weights
    save_controller(options.output, controller)
    robustness = check_robustness(
        model, controller.state_space(), CLOCK_PERIOD_S,
        max(GAIN_SPREAD, controller.report["hysteresis_gain_spread"]), at_once=options.at_once,
        delay_ticks=options.delay_ticks)
    _print(controller.report, design.rules, design.samples_per_tick, robustness)
    pictures = _draw(options, model, weights, controller)
    print(f"written: {', '.join(str(path) for path in (options.output, *pictures))}")
    print("next:", shlex.join([
        "./run", "piezo_client", "stage", "track", "--model", str(options.model), "--controller",
        str(options.output), "--output", "runs"]))


def _print(report: dict[str, Any], rules: LoopRules, samples_per_tick: int,
           robustness: Robustness) -> None:
    rate_hz = 1 / CLOCK_PERIOD_S / samples_per_tick
    lines = [
        ("feedback rate", f"{rate_hz:.4g} Hz, {samples_per_tick} samples a tick; by (5.10) "
                          f"{rules.lowest_rate_hz:.4g} to {rules.highest_rate_hz:.4g} Hz"),
        ("bandwidth by (5.9)", f"{rules.lowest_bandwidth_hz:.4g} to "
                               f"{rules.highest_bandwidth_hz:.4g} Hz"),
        ("loop shaping by (5.11)", f"performance below {rules.performance_hz:.4g} Hz, robustness "
                                   f"above {rules.robustness_hz:.4g} Hz"),
        *((label, "none" if report[key] is None else f"{report[key]:{layout}} {unit}".rstrip())
          for key, label, layout, unit in REPORT_ROWS if key in report),
        ("stable with 5 % errors of all parameters",
         f"{robustness.samples - robustness.unstable_samples} of {robustness.samples} drawn"),
        ("  Ms at the worst errors found", f"{robustness.worst_peak_sensitivity:.2f}"),
    ]
    for label, text in lines:
        print(f"{label:42s}{text}")


def _draw(options: argparse.Namespace, model: StageModel, weights: DesignWeights,
          controller: FeedbackController) -> list[Path]:
    """Draw the pictures; return their paths."""
    def path(name: str) -> Path:
        return options.output.with_name(f"{options.output.stem}_{name}.png")

    plant, gain_um_per_v = design_plant(model, weights.sample_period_s, CLOCK_PERIOD_S,
                                        options.at_once, options.delay_ticks)
    loop = gain_um_per_v * plant, controller.state_space()
    paths = [path("bode"), path("nyquist")]
    with_weights = weights if options.method == "h_infinity" else None
    draw_bode(paths[0], *loop, with_weights)
    draw_nyquist(paths[1], *loop, controller.report["hysteresis_gain_spread"])
    if with_weights:
        paths += [path("weights"), path("mu")]
        draw_weights(paths[2], weights)
        draw_mu(paths[3], *structured_singular_value(
            generalised_plant(plant, gain_um_per_v, weights), loop[1]),
            controller.report["mu_history"])
    return paths
