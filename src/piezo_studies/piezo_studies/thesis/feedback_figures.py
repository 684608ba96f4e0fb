# SPDX-License-Identifier: BSD-3-Clause
"""Section 5.3.1: H-infinity feedback with the weights of the thesis and with ours."""

import numpy as np

from piezo_common.picture_style import CURVES, label, new_figure
from piezo_controller.feedback.feedback_design import design_feedback
from piezo_controller.feedback.loop_measures import loop_responses
from piezo_controller.feedback.robustness import plant_errors
from piezo_controller.feedback.stage_design import choose_rates
from piezo_controller.feedback.synthesis.generalised_plant import design_plant
from piezo_controller.feedback.synthesis.weights import load_weights
from piezo_controller.feedback.synthesis.ziegler_nichols import ultimate_point_by_relay
from piezo_studies.thesis.figure_table import Row, Study
from piezo_studies.thesis.identified_stage import identified_stage

SECTION = "5.3.1"
CLOCK_PERIOD_S = 25e-6
GAIN_SPREAD = 0.12
DESIGNS = (
    ("without delay and mean", "thesis", True, "constant"),
    ("without delay and mean, dynamic D", "thesis", True, "dynamic"),
    ("with both", "thesis", False, "constant"),
    ("with both, our weights", "default", False, "constant"),
)
"""Name, weights, whether the loop has no delay, and kind of scaling D of each design."""

MEASURES = (("mu", "structured singular value", 0.81, "1"), ("gamma", "gamma", None, "1"),
            ("order_before_reduction", "order", 15, "1"),
            ("order", "order after reduction", None, "1"),
            ("bandwidth_hz", "bandwidth", None, "Hz"), ("peak_sensitivity", "Ms", None, "1"),
            ("gain_margin_at_highest_gain", "gain margin at the highest gain", None, "1"),
            ("phase_margin_deg_at_highest_gain", "phase margin at the highest gain", None, "deg"),
            ("settling_to_5_percent_s", "settling to 5 %", 0.020, "s"))
# The figures of the thesis belong to its own loop, which has no delay.
THESIS_DESIGN = DESIGNS[0][0]
SETTLING = "settling_to_5_percent_s"


def study():
    """Compute the figures and sensitivities of the designs."""
    model = identified_stage()
    ultimate_hz = 1 / ultimate_point_by_relay(model, 1, CLOCK_PERIOD_S).period_s
    rules = choose_rates(ultimate_hz, 1 / CLOCK_PERIOD_S, 50e-6, 40)
    rows = [
        Row(SECTION, "ultimate frequency by relay", 500.0, ultimate_hz, "Hz"),
        Row(SECTION, "feedback rate by (5.10)", 1000.0,
            1 / CLOCK_PERIOD_S / rules.samples_per_tick, "Hz",
            f"lower bound {rules.lowest_rate_hz:.0f} Hz; the thesis is at its bound, too"),
    ]
    frequency_hz = np.geomspace(1.0, 500.0, 500)
    figure = new_figure(3.4)
    axes = figure.subplots()
    for (name, weights_name, at_once, scaling), style in zip(DESIGNS, CURVES, strict=False):
        weights = load_weights(weights_name)
        found = design_feedback(model, weights, CLOCK_PERIOD_S, scaling=scaling, at_once=at_once)
        for key, quantity, thesis, unit in MEASURES:
            known = thesis if name == THESIS_DESIGN or key == SETTLING else None
            rows.append(Row(SECTION, f"{quantity}, {name}", known, found.report[key], unit,
                            "thesis: measured, Fig. 5.6" if key == SETTLING else ""))
        robust = plant_errors(model, found.sample_period_s, CLOCK_PERIOD_S, GAIN_SPREAD,
                              at_once).robustness(found.state_space())
        rows.append(Row(SECTION, f"Ms at the worst errors, {name}", None,
                        robust.worst_peak_sensitivity, "1",
                        f"5 % in every parameter, 12 % in the gain; of {robust.samples} drawn "
                        f"{robust.unstable_samples} are unstable"))
        plant, gain_um_per_v = design_plant(model, weights.sample_period_s, CLOCK_PERIOD_S, at_once)
        _, sensitivity = loop_responses(gain_um_per_v * plant, found.state_space(), frequency_hz)
        axes.loglog(frequency_hz, np.abs(sensitivity), label=name, **style)
    axes.legend(fontsize="x-small")
    label(axes, "frequency (Hz)", "sensitivity (um/um)")
    return Study(rows, {"5.4": figure})
