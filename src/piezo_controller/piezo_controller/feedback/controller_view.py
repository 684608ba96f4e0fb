# SPDX-License-Identifier: BSD-3-Clause
"""Presentation of a controller: one line, a table of its loop, a figure."""

from typing import TYPE_CHECKING

import numpy as np

from piezo_common.summary_table import SummaryTable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from piezo_controller.feedback.feedback_design import FeedbackController
    from piezo_models.cascade import StageModel

REPORT_ROWS = (
    ("order_before_reduction", "order before reduction", "d", ""),
    ("order", "order of the controller", "d", ""),
    ("gamma", "H-infinity norm with the scalings, gamma", ".3f", ""),
    ("mu", "structured singular value, mu", ".3f", ""),
    ("ultimate_gain_v_per_um", "ultimate gain", ".3f", "V/um"),
    ("ultimate_period_s", "ultimate period", ".5f", "s"),
    ("hysteresis_gain_um_per_v", "nominal hysteresis gain k_h", ".3f", "um/V"),
    ("hysteresis_gain_spread", "  varies by a part of", ".3f", ""),
    ("bandwidth_hz", "bandwidth (S at -3 dB)", ".1f", "Hz"),
    ("crossover_hz", "crossover (L at 0 dB)", ".1f", "Hz"),
    ("peak_sensitivity", "peak sensitivity Ms", ".2f", ""),
    ("peak_frequency_hz", "  at", ".0f", "Hz"),
    ("gain_margin", "gain margin", ".2f", ""),
    ("gain_margin_at_lowest_gain", "  at the lowest hysteresis gain", ".2f", ""),
    ("gain_margin_at_highest_gain", "  at the highest", ".2f", ""),
    ("phase_margin_deg", "phase margin", ".0f", "deg"),
    ("phase_margin_deg_at_lowest_gain", "  at the lowest hysteresis gain", ".0f", "deg"),
    ("phase_margin_deg_at_highest_gain", "  at the highest", ".0f", "deg"),
    ("settling_to_5_percent_s", "settling to 5 %", ".3f", "s"),
)
"""Key in the report, displayed name, number format, and unit."""

CLOCK_PERIOD_S = 25e-6


def text_of_controller(controller: "FeedbackController") -> str:
    """Return a one-line description of a controller."""
    report = controller.report
    parts = [f"{report.get('method', 'feedback')} of order {len(controller.A)}",
             f"{1.0 / controller.sample_period_s:.4g} Hz"]
    for key, what in (("bandwidth_hz", "bandwidth {:.4g} Hz"), ("peak_sensitivity", "Ms {:.3g}"),
                      ("phase_margin_deg", "phase margin {:.3g} deg")):
        if report.get(key) is not None:
            parts.append(what.format(report[key]))
    return f"<FeedbackController: {', '.join(parts)}>"


def summary_of_controller(controller: "FeedbackController") -> SummaryTable:
    """Return the table of a controller and of the loop that it was designed for."""
    report = controller.report
    rows: list[tuple[str | float | None, ...]] = [
        ("method", report.get("method", ""), ""),
        ("feedback rate", 1.0 / controller.sample_period_s, "Hz")]
    above = ""
    for key, name, _, unit in REPORT_ROWS:
        if not name.startswith(" "):
            above = name
        if key in report:
            whole = name if name == above else f"{above}, {name.strip()}"
            rows.append((whole, "none" if report[key] is None else report[key], unit))
    return SummaryTable("Feedback controller", ("", "value", "unit"), rows)


def draw_controller(controller: "FeedbackController",
                    model: "StageModel | None" = None) -> "Figure":
    """Draw the gain and phase of a controller, or the loop that it closes around a model.

    The loop is drawn as open loop, sensitivity and Nyquist diagram.
    """
    return _draw_response(controller) if model is None else _draw_loop(controller, model)


def _draw_response(controller: "FeedbackController") -> "Figure":
    from piezo_common.picture_style import BLUE, label, new_figure
    from piezo_controller.feedback.loop_pictures import drawn_frequencies

    system = controller.state_space()
    frequency_hz = drawn_frequencies(system.dt)
    response = system(np.exp(2j * np.pi * frequency_hz * system.dt), squeeze=True)
    figure = new_figure(4.6)
    gain, phase = figure.subplots(2, 1, sharex=True)
    gain.loglog(frequency_hz, np.abs(response), color=BLUE)
    phase.semilogx(frequency_hz, np.degrees(np.unwrap(np.angle(response))), color=BLUE)
    label(gain, None, "gain (V/um)", "controller")
    label(phase, "frequency (Hz)", "phase (degrees)")
    return figure


def _draw_loop(controller: "FeedbackController", model: "StageModel") -> "Figure":
    from piezo_common.picture_style import CURVES, WIDE_IN, label, new_figure
    from piezo_controller.feedback.loop_measures import loop_responses
    from piezo_controller.feedback.loop_pictures import drawn_frequencies, nyquist_on
    from piezo_controller.feedback.synthesis.generalised_plant import (
        design_plant,
        hysteresis_gain_range,
    )

    plant, gain_um_per_v = design_plant(
        model, controller.sample_period_s, CLOCK_PERIOD_S,
        bool(controller.report.get("at_once", False)), controller.delay_ticks)
    system, plant = controller.state_space(), gain_um_per_v * plant
    frequency_hz = drawn_frequencies(system.dt)
    loop, sensitivity = loop_responses(plant, system, frequency_hz)
    figure = new_figure(4.0, WIDE_IN)
    gain, nyquist = figure.subplots(1, 2)
    for response, name, style in ((loop, "open loop L", CURVES[0]),
                                  (sensitivity, "sensitivity S", CURVES[1]),
                                  (1.0 - sensitivity, "complementary T", CURVES[2])):
        gain.loglog(frequency_hz, np.abs(response), label=name, **style)
    gain.set_ylim(1e-3, None)
    gain.legend(loc="lower left")
    label(gain, "frequency (Hz)", "gain (1)")
    nyquist_on(nyquist, plant, system, hysteresis_gain_range(model)[1] / gain_um_per_v - 1.0)
    nyquist.legend(loc="lower right")
    return figure
