# SPDX-License-Identifier: BSD-3-Clause
"""Implementation of `design` for a model of several axes: write, print and draw its law."""

import argparse
from hashlib import sha256

import control
import numpy as np

from piezo_common.command_line import print_next, write_report
from piezo_common.picture_style import to_png
from piezo_common.report_page import Section
from piezo_controller.feedback.axes_design import (
    axes_plant_errors,
    design_axes_feedback,
    scaled_plant,
)
from piezo_controller.feedback.design_page import page_of_loop
from piezo_controller.feedback.feedback_design import structured_singular_value
from piezo_controller.feedback.loop_pictures import mu_figure, sensitivity_figure, weights_figure
from piezo_controller.feedback.robustness import PARAMETER_ERROR, Robustness
from piezo_controller.feedback.synthesis.generalised_plant import generalised_plant
from piezo_controller.feedback.synthesis.weights import load_weights
from piezo_models.axes_model_file import load_axes_model
from piezo_models.feedback_law.axes_law import AxesLaw, save_axes_law

OF_ONE_AXIS = {"method": "h_infinity", "feedback": None, "scaling": "constant", "at_once": False}
"""Options that a law of several axes does not take, and their defaults."""

ROWS = (
    ("order", "order of the law", "d", ""),
    ("gamma", "H-infinity norm with the scalings, gamma", ".3f", ""),
    ("mu", "structured singular value, mu", ".3f", ""),
    ("hysteresis_gain_spread", "gains of the hysteresis vary by a part of", ".3f", ""),
    ("bandwidth_hz", "bandwidth (S at -3 dB, all directions)", ".1f", "Hz"),
    ("peak_sensitivity", "peak sensitivity Ms, all directions", ".2f", ""),
    ("peak_frequency_hz", "  at", ".0f", "Hz"),
    ("gain_margin", "gain margin, at least", ".2f", ""),
    ("phase_margin_deg", "phase margin, at least", ".0f", "deg"),
)
"""Key in the report, displayed name, number format, and unit."""

DRAWN = 40
"""Number of perturbed models whose responses are drawn."""


def design_axes_law(options: argparse.Namespace) -> None:
    """Design the law of several axes; write it, print its margins and draw its loop."""
    for name, usual in OF_ONE_AXIS.items():
        if getattr(options, name) != usual:
            raise ValueError(f"--{name.replace('_', '-')} is of one axis: leave it out with a "
                             "model of several")
    model = load_axes_model(options.model).model
    weights = load_weights(options.weights)
    tick_s = options.samples_per_tick * model.sample_period_s if options.samples_per_tick else (
        weights.sample_period_s)
    weights = weights.for_disturbances(options.disturbance_hz).at_tick(tick_s)
    law = design_axes_feedback(model, weights, sha256(options.model.read_bytes()).hexdigest(),
                               not options.full_order)
    save_axes_law(options.output, law)
    plant, gains_um_per_v = scaled_plant(model, tick_s)
    controller = np.diag(gains_um_per_v) * control.ss(*law.tick.matrices, tick_s)
    errors = axes_plant_errors(model, tick_s)
    robustness = errors.robustness(controller)
    rows = _rows(law, robustness)
    for name, text in rows:
        print(f"{name:42s}{text}")
    figures = {
        "sensitivity": sensitivity_figure(plant, controller, errors.drawn(DRAWN), model.axes),
        "weights": weights_figure(weights),
        "mu": mu_figure(*structured_singular_value(
            generalised_plant(plant, 1.0, weights), controller), law.report["mu_history"])}
    picture = options.output.with_name(f"{options.output.stem}_sensitivity.png")
    picture.write_bytes(to_png(figures["sensitivity"]))
    print(f"written: {options.output}, {picture}")
    if options.report:
        page = page_of_loop(
            law.report, rows, figures,
            [f"law: `{options.output}`",
             f"model: `{options.model}`, SHA-256 {law.model_sha256[:16]}"],
            Section("Margins", [_margins_sentence(robustness)]))
        write_report(options.output.with_name(f"{options.output.stem}_report.html"), page)
    print_next(options, "piezo_client", "stage", "scan", "<a folder of scan>", "--feedback",
               options.output, "--output", "runs")


def _rows(law: AxesLaw, robustness: Robustness) -> list[tuple[str, str]]:
    """Return the rows of the report in the order in which they are printed."""
    report, tick_s = law.report, law.sample_period_s * law.samples_per_tick
    rows = [("sample clock of the stage", f"{1.0 / law.sample_period_s:.6g} Hz, as of the model"),
            ("feedback rate", f"{1.0 / tick_s:.4g} Hz, {law.samples_per_tick} samples a tick")]
    rows += [(name, _text(report[key], layout, unit)) for key, name, layout, unit in ROWS]
    rows += [(f"bandwidth of {axis}", _text(hz, ".1f", "Hz"))
             for axis, hz in report["bandwidth_hz_of_axis"].items()]
    return [*rows,
            ("stable with 5 % errors of all modes",
             f"{robustness.samples - robustness.unstable_samples} of {robustness.samples} drawn"),
            ("  Ms at the worst errors found", f"{robustness.worst_peak_sensitivity:.2f}")]


def _text(value: float | None, layout: str, unit: str) -> str:
    return "none" if value is None else f"{value:{layout}} {unit}".rstrip()


def _margins_sentence(robustness: Robustness) -> str:
    return (
        "The peak of the largest singular value of the sensitivity guarantees the margins: at the "
        "sensors, the gains or the phases of all axes may change independently. The loop is stable "
        "at every combination of the lowest and highest gains of the hysteresis. Of "
        f"{robustness.samples} models with gains within this spread, and random errors of up to "
        f"{100 * PARAMETER_ERROR:.0f} % of the frequency, the damping and the share of each mode, "
        f"{robustness.samples - robustness.unstable_samples} are stable.")
