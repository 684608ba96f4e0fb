# SPDX-License-Identifier: BSD-3-Clause
"""Summarise the demo's runs as plain values and as text tables."""

import os

import numpy as np

from piezo_models.measures import e_rms_percent

# e_rms in percent by mode and frequency in Hz: Table 3.1 and section 5.3.3 of the thesis.
THESIS_E_RMS_PERCENT = {
    "open_loop": {40.0: 12.9, 100.0: 29.1},
    "composite": {40.0: 0.75, 100.0: 1.21, 500.0: 2.3, 1000.0: 2.2},
}

# Head and format of each column of the table.
COLUMNS = {
    "frequency_hz": ("Hz", "{:g}"),
    "amplitude_um": ("um p-p", "{:g}"),
    "mode": ("mode", "{}"),
    "e_rms_percent": ("simulated stage, e_rms %", "{:.3f}"),
    "thesis_e_rms_percent": ("real stage (thesis) %", "{:g}"),
    "e_rms_true_percent": ("true %", "{:.3f}"),
    "e_rms_without_offset_percent": ("no offset %", "{:.3f}"),
    "largest_error_um": ("largest um", "{:.3f}"),
}
NONE = "-"


def summarise(runs, identification, directory):
    """Return the summary of runs, with the errors of the model on unseen data by name.

    Paths of recordings are relative to the directory. ``lockstep_ratio`` is the simulated seconds
    per wall second in all runs with feedback.
    """
    return {
        "tracking": [summarise_run(run, directory) for run in runs],
        "identification": identification,
        "lockstep_ratio": lockstep_ratio(runs),
    }


def summarise_run(run, directory):
    """Return one run with the thesis' figure or None, and its errors.

    These are e_rms (2.32) by the sensor, of the simulator's true displacement, and by the sensor
    without the mean error.
    """
    return {
        "frequency_hz": run.frequency_hz,
        "amplitude_um": run.amplitude_um,
        "centre_um": run.centre_um,
        "mode": run.mode,
        "e_rms_percent": e_rms_percent(run.reference_um, run.displacement_um),
        "e_rms_true_percent": e_rms_percent(run.reference_um, run.true_um),
        "e_rms_without_offset_percent": e_rms_percent(
            run.reference_um, run.displacement_um, remove_offset=True),
        "offset_um": float(run.error_um.mean()),
        "largest_error_um": float(np.abs(run.error_um).max()),
        "missed_feedback": run.missed_feedback,
        "thesis_e_rms_percent": THESIS_E_RMS_PERCENT.get(run.mode, {}).get(run.frequency_hz),
        "recording": os.path.relpath(run.path, directory),
    }


def lockstep_ratio(runs):
    """Return the simulated seconds per wall second of the runs with feedback."""
    closed = [run for run in runs if run.mode == "composite"]
    if not closed:
        raise ValueError("no run with feedback: track one in mode composite")
    return sum(run.loop_s for run in closed) / sum(run.loop_wall_s for run in closed)


def table_rows(summary):
    """Return the table of tracking errors: the heads, then a row for each run."""
    return [[head for head, _ in COLUMNS.values()],
            *([_text(entry[key], form) for key, (_, form) in COLUMNS.items()]
              for entry in summary["tracking"])]


def model_error_rows(summary):
    """Return the table of the model's error before and after its extension."""
    before, after = summary["diagnosis"]["before"], summary["diagnosis"]["after"]
    return [["model error on unseen data", "before", "after"],
            ["RMS nm", *(f"{1e3 * errors['rms_um']:.1f}" for errors in (before, after))],
            ["e_y %", *(f"{errors['e_y_percent']:.3f}" for errors in (before, after))]]


def tracking_error_rows(summary):
    """Return the table of e_rms by the sensor before and after the extension of the model."""
    before = {(e["frequency_hz"], e["mode"]): e for e in summary["tracking"]}
    rows = [["Hz", "um p-p", "mode", "simulated, before %", "simulated, after %",
             "real (thesis) %"]]
    for entry in summary["tracking_after"]:
        values = (before[entry["frequency_hz"], entry["mode"]]["e_rms_percent"],
                  entry["e_rms_percent"])
        rows.append([*(_text(entry[key], COLUMNS[key][1])
                       for key in ("frequency_hz", "amplitude_um", "mode")),
                     *(f"{value:.3f}" for value in values),
                     _text(entry["thesis_e_rms_percent"], "{:g}")])
    return rows


def aligned(rows):
    """Return a table as text, whose first row has the heads."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(text.rjust(width) for text, width in zip(row, widths, strict=True))
             for row in rows]
    return "\n".join([lines[0], "-" * len(lines[0]), *lines[1:]])


def _text(value, form):
    return NONE if value is None else form.format(value).replace("_", " ")
