# SPDX-License-Identifier: BSD-3-Clause
"""Well-known feedbacks by name, designed for the same margin and compared.

Each answers every sample and is tuned for the largest attenuation at a frequency and at twice
that frequency. Its gain is then set so that the peak of the sensitivity over all stages within
the model's errors is the same for all feedbacks.
"""

from collections.abc import Mapping

import control
import numpy as np
from matplotlib.figure import Figure

from piezo_common.picture_style import CURVES, GREY, LIMIT, label, new_figure
from piezo_common.report_page import Section, pictured, render_page
from piezo_common.summary_table import SummaryTable
from piezo_controller.feedback.feedback_design import FeedbackController, UnstableLoop
from piezo_controller.feedback.sample_rate.demands import Demands
from piezo_controller.feedback.sample_rate.fast_design import check_modes, measured_design
from piezo_controller.feedback.sample_rate.perturbed_loops import ModelErrors, PerturbedLoops
from piezo_controller.feedback.sample_rate.repetitive import MOST_MULTIPLES
from piezo_controller.feedback.sample_rate.searched_designs import design_by
from piezo_controller.feedback.synthesis.design_choices import FEEDBACKS, PEAK_SENSITIVITY
from piezo_models.cascade import StageModel

ERRORS = ModelErrors(0.05, 0.05)
"""Errors of all parameters, the same as `plant_errors` draws."""

NO_BANDWIDTH = 1e-3
"""Bandwidth over the first mode's frequency that every loop exceeds: only attenuation counts."""

REPEATED = 1e-3
"""Relative error of the repeated frequency, ten times that of a quartz clock."""

FACTORS = np.geomspace(0.25, 4.0, 65)
"""Factors of the gain that are tried; the search ends within a factor of two of the margin."""

HALVINGS = 12

STYLES = (*CURVES, {"color": GREY, "linewidth": 1.0})
"""Line styles, one for each feedback."""

ROUNDED = 1e-3
"""Tolerance of the peak sensitivity, relative to it."""


def feedback_at_margin(name: str, model: StageModel, frequency_hz: float,
                       peak_sensitivity: float = PEAK_SENSITIVITY, clock_period_s: float = 25e-6,
                       model_sha256: str = "", effort: float = 1.0) -> FeedbackController:
    """Design a feedback by its name, for a stage that evaluates it by itself.

    Parameters
    ----------
    name : str
        One of `piezo_controller.feedback.synthesis.design_choices.FEEDBACKS`.
    model : StageModel
        Model with a mode, and without antiresonances.
    frequency_hz : float
        Frequency at which, together with its double, the attenuation is largest; repetitive
        feedback attenuates its multiples.
    peak_sensitivity : float
        Peak of the sensitivity of the worst stage.
    model_sha256 : str
        Hash of the model's file, kept with the controller.
    effort : float
        Factor on the number of laws that are tried.

    Returns
    -------
    FeedbackController
        See `measured_design`; its report also holds the ``numbers`` of the law.

    Raises
    ------
    UnstableLoop
        If no gain gives this margin.
    ValueError
        If there is no such feedback; the model has no mode, or has antiresonances; or a
        repetitive feedback is requested above the first mode.
    """
    if name not in FEEDBACKS:
        raise ValueError(f"unknown feedback {name!r}: use one of {', '.join(FEEDBACKS)}")
    check_modes(model)
    demands = Demands(NO_BANDWIDTH, (frequency_hz, 2.0 * frequency_hz), (0.0, 0.0),
                      worst_peak_sensitivity=peak_sensitivity, errors=ERRORS,
                      disturbance_tolerance=REPEATED)
    method = name.replace("-", "_")
    loops = demands.loops(model, clock_period_s)
    found = design_by(method, model, demands, clock_period_s, effort, loops)
    system = _at_margin(name, found.state_space(), loops, peak_sensitivity)
    kept = {key: found.report[key] for key in ("numbers", "repeats_hz") if key in found.report}
    return measured_design(system, model, demands, loops, method, kept, model_sha256)


def _at_margin(name: str, system: control.StateSpace, loops: PerturbedLoops,
               peak_sensitivity: float) -> control.StateSpace:
    """Return a feedback with the largest gain that keeps within the peak for all stages."""
    def keeps(factor: float) -> bool:
        figures = loops.measure(factor * system)
        return figures.worst_peak_sensitivity <= (1.0 + ROUNDED) * peak_sensitivity

    kept = np.flatnonzero([keeps(factor) for factor in FACTORS])
    if not kept.size:
        raise UnstableLoop(f"no gain of {name} has a peak sensitivity of {peak_sensitivity:g}: "
                           "give a larger one")
    low, high = FACTORS[kept[-1]], FACTORS[min(kept[-1] + 1, FACTORS.size - 1)]
    for _ in range(HALVINGS):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if keeps(middle) else (low, middle)
    return low * system


def comparison_table(controllers: Mapping[str, FeedbackController]) -> SummaryTable:
    """Return a table that compares feedbacks of `feedback_at_margin`, one per row."""
    demands = next(iter(controllers.values())).report["demands"]
    first_hz, second_hz = demands["disturbance_hz"]
    rows: list[tuple[str | float | None, ...]] = []
    for name, controller in controllers.items():
        report, figures = controller.report, controller.report["figures"]
        rows.append((name, figures["bandwidth_hz"], *figures["attenuation_db"],
                     min(figures["worst_attenuation_db"]), figures["worst_peak_sensitivity"],
                     1e3 * report["added_noise_um"], report["noise_voltage_v"], report["order"]))
    return SummaryTable(
        f"Feedbacks at a peak sensitivity of {demands['worst_peak_sensitivity']:g}",
        ("feedback", "bandwidth (Hz)", f"at {first_hz:g} Hz (dB)", f"at {second_hz:g} Hz (dB)",
         "least (dB)", "peak", "noise (nm)", "noise (V)", "order"),
        rows, (
            "bandwidth: where the closed loop first falls to -3 dB",
            "dB: attenuation of a disturbance by the model; least: of all stages that the errors "
            "of the model allow",
            "peak: of the sensitivity, of all stages; noise: what "
            f"{1e3 * demands['sensor_noise_um']:g} nm of the sensor add"))


def comparison_figure(model: StageModel, controllers: Mapping[str, FeedbackController]) -> Figure:
    """Draw the sensitivities of the model with feedbacks of `feedback_at_margin`."""
    figure = new_figure(4.4)
    axes = figure.subplots()
    some = next(iter(controllers.values()))
    demands = some.report["demands"]
    multiples_hz = demands["disturbance_hz"][0] * np.arange(1, MOST_MULTIPLES + 1)
    loops = PerturbedLoops(model, ModelErrors(0.0, 0.0), some.sample_period_s,
                           tuple(multiples_hz), delay_ticks=0, coarse=600)
    for (name, controller), style in zip(controllers.items(), STYLES, strict=False):
        response = controller.state_space()(loops.points, squeeze=False)[0, 0]
        axes.loglog(loops.frequency_hz, np.abs(1.0 / (1.0 + loops.responses[0] * response)),
                    label=name, **style)
    axes.axhline(demands["worst_peak_sensitivity"], **LIMIT)
    axes.set_ylim(1e-3, None)
    axes.legend(fontsize="small")
    label(axes, "frequency (Hz)", "sensitivity (1)")
    return figure


def comparison_page(model: StageModel, controllers: Mapping[str, FeedbackController],
                    origin: list[str]) -> str:
    """Return the HTML page that compares feedbacks of `feedback_at_margin`."""
    table = comparison_table(controllers)
    best = max(controllers, key=lambda name: controllers[name].report["margin_db"])
    cells = [[cell if isinstance(cell, str) else f"{cell:.4g}" for cell in row]
             for row in table.rows]
    return render_page(
        f"{best} attenuates most: {controllers[best].report['margin_db']:.3g} dB", origin, [
            Section(table.title, table.notes, [table.heads, *cells], [pictured(
                "Sensitivity", comparison_figure(model, controllers),
                "Part of a disturbance that remains, at each frequency; dotted, the peak that "
                "no stage exceeds.", wide=True, closer=True)]),
            Section("How", [
                "Each law answers every sample, and was searched for the largest attenuation. Its "
                "gain was then set so that no stage has a larger peak, with all parameters off by "
                f"{100 * ERRORS.parameter:g} %."])])
