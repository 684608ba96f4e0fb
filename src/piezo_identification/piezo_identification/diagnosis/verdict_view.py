# SPDX-License-Identifier: BSD-3-Clause
"""Presentation of a verdict: one line, a table, and a figure of its errors and effects."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from piezo_common.summary_table import Cell, SummaryTable
from piezo_identification.diagnosis.evidence.stand_ins import name_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from piezo_identification.diagnosis.verdict import Verdict

HEADS = ("", "value", "std. dev.", "unit")


def text_of_verdict(verdict: "Verdict") -> str:
    """Return a verdict in one line."""
    named = " and ".join(map(name_of, verdict.effects))
    before, after = (errors["rms_um"] for errors in (verdict.before, verdict.after))
    return (f"<{type(verdict).__name__}: {verdict.verdict}{' by ' if named else ''}{named}, "
            f"{1e3 * before:.4g} nm RMS before, {1e3 * after:.4g} nm after, "
            f"{1e3 * verdict.noise_floor_um:.4g} nm noise>")


def summary_of_verdict(verdict: "Verdict") -> SummaryTable:
    """Return the table of a verdict: errors on held-out data, and the effects with parameters."""
    rows: list[tuple[Cell, ...]] = []
    for when, errors in (("before", verdict.before), ("after", verdict.after)):
        rows += [(f"RMS error, {when}", 1e3 * errors["rms_um"], None, "nm"),
                 (f"relative error e_y, {when}", errors["e_y_percent"], None, "%")]
    rows.append(("noise of the sensor", 1e3 * verdict.noise_floor_um, None, "nm"))
    for entry in verdict.effects:
        rows += _effect_rows(entry)
    rows += [(f"probability of {name}", 100.0 * value, None, "%")
             for name, value in verdict.document().get("probabilities", {}).items()]
    notes = [*(str(fault["sentence"]) for fault in verdict.recording_faults),
             *verdict.left_out, verdict.left,
             *(f"{name} cannot be decided: {why}" for name, why in verdict.not_decidable.items())]
    held_out = "{samples} samples of {source}".format(**verdict.holdout)
    return SummaryTable(f"Verdict: {verdict.verdict}; errors on {held_out}", HEADS, rows,
                        tuple(filter(None, notes)))


def _effect_rows(entry: dict[str, Any]) -> Iterator[tuple[Cell, ...]]:
    yield (f"{name_of(entry)}, error reduction", entry["error_reduction_percent"], None, "%")
    deviations = entry.get("standard_deviations", {})
    for name, value in entry["parameters"].items():
        values = np.atleast_1d(value)
        known = np.atleast_1d(deviations.get(name, [None] * values.size))
        for number, (each, deviation) in enumerate(zip(values, known, strict=True), 1):
            counted = f" {number}" if values.size > 1 else ""
            yield (f"{entry['name']}, {name}{counted}", float(each),
                   None if deviation is None else float(deviation), "")


def draw_verdict(verdict: "Verdict") -> "Figure":
    """Draw the errors before and after with the noise, and the error reduction of each effect."""
    from piezo_common.picture_style import BLACK, BLUE, GREY, ORANGE, WIDE_IN, label, new_figure

    figure = new_figure(3.0, WIDE_IN)
    errors, effects = figure.subplots(1, 2)
    errors.barh(["noise", "after", "before"],
                [1e3 * value for value in (verdict.noise_floor_um, verdict.after["rms_um"],
                                           verdict.before["rms_um"])],
                color=[GREY, BLUE, ORANGE])
    label(errors, "RMS error on held-out data (nm)", None, f"verdict: {verdict.verdict}")
    found = verdict.effects[::-1]
    effects.barh([entry["name"] for entry in found],
                 [entry["error_reduction_percent"] for entry in found], color=BLUE)
    effects.set_xlim(0.0, 100.0)
    label(effects, "error reduction (%)", None, "effects")
    if not found:
        effects.text(50.0, 0.0, "no effect is named", ha="center", va="center", color=BLACK)
        effects.set(yticks=[], ylim=(-1.0, 1.0))
    return figure
