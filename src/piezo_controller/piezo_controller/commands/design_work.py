# SPDX-License-Identifier: BSD-3-Clause
"""Implementation of `design`: design the controller; write, print and draw it."""

import argparse
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

import control
from matplotlib.figure import Figure

from piezo_common.command_line import print_next, print_progress, write_report
from piezo_common.picture_style import to_png
from piezo_controller.commands.axes_design_work import design_axes_law
from piezo_controller.feedback.controller_file import save_controller
from piezo_controller.feedback.controller_view import REPORT_ROWS
from piezo_controller.feedback.design_page import margins_section, page_of_loop
from piezo_controller.feedback.feedback_design import (
    FeedbackController,
    UnstableLoop,
    structured_singular_value,
)
from piezo_controller.feedback.loop_pictures import (
    bode_figure,
    mu_figure,
    nyquist_figure,
    sensitivity_figure,
    step_figure,
    weights_figure,
)
from piezo_controller.feedback.robustness import PlantErrors, Robustness, plant_errors
from piezo_controller.feedback.sample_rate.named_feedbacks import (
    comparison_figure,
    comparison_page,
    comparison_table,
    feedback_at_margin,
)
from piezo_controller.feedback.stage_design import StageDesign, design_for_stage
from piezo_controller.feedback.synthesis.design_choices import ALL, FEEDBACKS
from piezo_controller.feedback.synthesis.generalised_plant import design_plant, generalised_plant
from piezo_controller.feedback.synthesis.h_infinity import is_stable
from piezo_controller.feedback.synthesis.weights import DesignWeights
from piezo_models.cascade import StageModel
from piezo_models.model_file import announced_model, is_of_several_axes

GAIN_SPREAD = 0.12
DRAWN = 40
"""Number of perturbed models whose responses are drawn."""

ALONE = ("bode", "nyquist", "weights", "mu", "comparison")
"""Figures that are also written to separate files."""

DOTS_PER_INCH = 120


def design_controller(options: argparse.Namespace) -> None:
    """Design the controller; write it, print its margins and draw its loop."""
    if is_of_several_axes(options.model):
        design_axes_law(options)
        return
    model = announced_model(options.model).model
    if options.feedback:
        _design_named(options, model)
        return
    design = design_for_stage(
        model, options.weights, options.method, options.scaling, options.disturbance_hz,
        options.samples_per_tick, options.at_once, not options.full_order, options.delay_ticks,
        sha256(options.model.read_bytes()).hexdigest(), options.rate)
    controller, weights, clock_s = design.controller, design.weights, design.clock_period_s
    save_controller(options.output, controller)
    gain_spread = max(GAIN_SPREAD, controller.report["hysteresis_gain_spread"])
    errors = plant_errors(model, controller.sample_period_s, clock_s, gain_spread,
                          options.at_once, options.delay_ticks)
    robustness = errors.robustness(controller.state_space())
    rows = _rows(controller.report, design, robustness)
    for name, text in rows:
        print(f"{name:42s}{text}")
    figures = _figures(options, model, weights, clock_s, controller, errors)
    pictures = _save(options.output, figures)
    print(f"written: {', '.join(str(path) for path in (options.output, *pictures))}")
    if options.report:
        origin = [f"controller: `{options.output}`", f"model: `{options.model}`, SHA-256 "
                  f"{controller.model_sha256[:16]}"]
        write_report(options.output.with_name(f"{options.output.stem}_report.html"), page_of_loop(
            controller.report, rows, figures, origin,
            margins_section(controller.report, robustness)))
    print_next(options, "piezo_client", "stage", "track", "--model", options.model, "--controller",
               options.output, "--output", "runs")


def _design_named(options: argparse.Namespace, model: StageModel) -> None:
    """Design the feedback of a given name, or all of them; write, print and draw the comparison."""
    names = FEEDBACKS if options.feedback == ALL else (options.feedback,)
    digest = sha256(options.model.read_bytes()).hexdigest()
    controllers = {}
    for number, name in enumerate(names):
        print_progress(name, number / len(names))
        try:
            controllers[name] = feedback_at_margin(
                name, model, options.disturbance_hz, options.peak_sensitivity, 1.0 / options.rate,
                digest)
        except UnstableLoop as error:
            if options.feedback != ALL:
                raise
            print(f"{name}: {error}")
    if not controllers:
        raise UnstableLoop("no feedback has this margin: give a larger --peak-sensitivity")
    output = options.output
    paths = {name: output if options.feedback != ALL else
             output.with_name(f"{output.stem}_{name.replace('-', '_')}{output.suffix}")
             for name in controllers}
    for name, controller in controllers.items():
        save_controller(paths[name], controller)
    print(comparison_table(controllers))
    pictures = _save(output, {"comparison": comparison_figure(model, controllers)})
    print(f"written: {', '.join(map(str, (*paths.values(), *pictures)))}")
    if options.report:
        write_report(output.with_name(f"{output.stem}_report.html"), comparison_page(
            model, controllers, [f"model: `{options.model}`, SHA-256 {digest[:16]}"]))
    best = max(controllers, key=lambda name: controllers[name].report["margin_db"])
    print_next(options, "piezo_client", "stage", "track", "--model", options.model, "--controller",
               paths[best], "--output", "runs")


def _rows(report: dict[str, Any], design: StageDesign,
          robustness: Robustness) -> list[tuple[str, str]]:
    """Return the rows of the report in the order in which they are printed."""
    rules, samples = design.rules, design.samples_per_tick
    clock_hz = 1.0 / design.clock_period_s
    return [
        ("sample clock of the stage", f"{clock_hz:.6g} Hz; --rate takes another one"),
        ("feedback rate", f"{clock_hz / samples:.4g} Hz, {samples} samples a tick; by (5.10) "
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


def _figures(options: argparse.Namespace, model: StageModel, weights: DesignWeights,
             clock_s: float, controller: FeedbackController, errors: PlantErrors,
             ) -> dict[str, Figure]:
    plant, gain_um_per_v = design_plant(model, weights.sample_period_s, clock_s,
                                        options.at_once, options.delay_ticks)
    loop = gain_um_per_v * plant, controller.state_space()
    with_weights = weights if options.method == "h_infinity" else None
    figures = {
        "bode": bode_figure(*loop, with_weights),
        "nyquist": nyquist_figure(*loop, controller.report["hysteresis_gain_spread"])}
    if options.report:
        drawn = [each for each in errors.drawn(DRAWN)
                 if is_stable(control.feedback(each * loop[1], 1))]
        figures["steps"] = step_figure(
            *loop, controller.report["hysteresis_gain_spread"], drawn)
        figures["sensitivity"] = sensitivity_figure(*loop, drawn)
    if with_weights:
        figures["weights"] = weights_figure(weights)
        figures["mu"] = mu_figure(*structured_singular_value(
            generalised_plant(plant, gain_um_per_v, weights), loop[1]),
            controller.report["mu_history"])
    return figures


def _save(output: Path, figures: Mapping[str, Figure]) -> list[Path]:
    """Write the separate figures next to those of the page; return their paths."""
    paths = []
    for name in (name for name in ALONE if name in figures):
        paths.append(output.with_name(f"{output.stem}_{name}.png"))
        paths[-1].write_bytes(to_png(figures[name], DOTS_PER_INCH))
    return paths
