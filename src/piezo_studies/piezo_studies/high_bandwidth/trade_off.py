# SPDX-License-Identifier: BSD-3-Clause
"""Compare the methods at equal robustness for several errors of the light mode."""

import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from itertools import cycle, product
from pathlib import Path

import numpy as np

from piezo_common.picture_style import CURVES, LIMIT, label, new_figure
from piezo_controller.feedback.controller_file import load_controller, save_controller
from piezo_controller.feedback.feedback_design import FeedbackController, UnstableLoop
from piezo_controller.feedback.sample_rate.classical_forms import FORMS
from piezo_controller.feedback.sample_rate.demands import Demands
from piezo_controller.feedback.sample_rate.fast_design import METHOD
from piezo_controller.feedback.sample_rate.searched_designs import H_INFINITY, design_by
from piezo_controller.feedback.synthesis.generalised_plant import nominal_hysteresis_gain
from piezo_models.cascade import StageModel
from piezo_studies.tables import markdown_table

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

    A design for the same demands is used again if it is in the directory `kept` of controllers.
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


HEADER = ("method", "light mode off by", "worst peak", "margin", "bandwidth", "lowest bandwidth",
          "at 50 Hz", "least", "at 100 Hz", "least", "added noise", "noise of the voltage", "order")

SEARCH_HEADER = "light mode off by", "to reach the demands", "seed", "starts, trials", "margin"


def searched_table(searches):
    """Return the table of search results as Markdown."""
    rows = []
    for found in searches:
        demands = found["demands"]
        rows.append((
            f"{100 * demands['errors']['light_mode']:.0f} %",
            "every stage" if demands["of_every_stage"] else "the model",
            str(found["seed"]), f"{found['starts']}, {found['trials']}",
            f"{found['margin_db']:+.1f} dB"))
    return markdown_table(SEARCH_HEADER, sorted(rows))


def draw(compared):
    """Return the figure of the margins over the light mode's error."""
    figure = new_figure()
    axes = figure.subplots()
    for (method, name), style in zip(TITLES.items(), cycle(CURVES), strict=False):
        margins = [next((row.controller.report["margin_db"] for row in compared
                         if (row.method, row.light_mode_error, row.of_every_stage)
                         == (method, error, False) and row.keeps_bounds), np.nan)
                   for error in LIGHT_MODE_ERRORS]
        axes.plot(100 * np.array(LIGHT_MODE_ERRORS), margins, marker="o", label=name, **style)
    axes.axhline(0.0, **LIMIT)
    label(axes, "error of the light mode (%)", "margin to the demands (dB)")
    axes.legend(fontsize="x-small")
    return figure


def _row(row):
    cells = [TITLES[row.method], f"{100 * row.light_mode_error:.0f} %"]
    if row.controller is None:
        return [*cells, "not stable", *[""] * (len(HEADER) - 3)]
    report, figures = row.controller.report, row.controller.report["figures"]
    attenuation = [f"{db:.1f} dB" for both in zip(
        figures["attenuation_db"], figures["worst_attenuation_db"], strict=True) for db in both]
    cells += [f"{figures['worst_peak_sensitivity']:.2f}", f"{report['margin_db']:+.1f} dB",
              f"{figures['bandwidth_hz']:.0f} Hz", f"{figures['worst_bandwidth_hz']:.0f} Hz",
              *attenuation, f"{1e3 * report['added_noise_um']:.1f} nm",
              f"{report['noise_voltage_v']:.2f} V", str(report["order"])]
    return cells if row.keeps_bounds else [cells[0], *(f"({cell})" for cell in cells[1:])]


def sections(compared, searches=()):
    """Return the tables of designs and of search results, by their marks in the page."""
    tables = {name: markdown_table(HEADER, (
        _row(row) for row in compared if row.of_every_stage == every_stage))
        for every_stage, name in ((False, "the model itself"), (True, "every stage"))}
    if searches:
        tables["searches"] = searched_table(searches)
    return {f"designs: {name}": table for name, table in tables.items()}
