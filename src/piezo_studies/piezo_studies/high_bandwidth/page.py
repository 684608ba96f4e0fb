# SPDX-License-Identifier: BSD-3-Clause
"""The tables and the figure of the study."""

from itertools import cycle

import numpy as np

from piezo_common.picture_style import CURVES, LIMIT, label, new_figure
from piezo_studies.high_bandwidth.trade_off import LIGHT_MODE_ERRORS, TITLES

HEADER = ("method", "light mode off by", "worst peak", "margin", "bandwidth", "lowest bandwidth",
          "at 50 Hz", "least", "at 100 Hz", "least", "added noise", "noise of the voltage", "order")

SEARCH_HEADER = "light mode off by", "to reach the demands", "seed", "starts, trials", "margin"


def searched_table(searches):
    """Return the rows of the table of search results."""
    rows = []
    for found in searches:
        demands = found["demands"]
        rows.append((
            f"{100 * demands['errors']['light_mode']:.0f} %",
            "every stage" if demands["of_every_stage"] else "the model",
            str(found["seed"]), f"{found['starts']}, {found['trials']}",
            f"{found['margin_db']:+.1f} dB"))
    return [SEARCH_HEADER, ["---"] * len(SEARCH_HEADER), *sorted(rows)]


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
    tables = {name: [HEADER, ["---"] * len(HEADER),
                     *(_row(row) for row in compared if row.of_every_stage == every_stage)]
              for every_stage, name in ((False, "the model itself"), (True, "every stage"))}
    if searches:
        tables["searches"] = searched_table(searches)
    return {f"designs: {name}": "".join("| " + " | ".join(cells) + " |\n" for cells in rows)
            for name, rows in tables.items()}
