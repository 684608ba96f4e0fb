# SPDX-License-Identifier: BSD-3-Clause
"""Presentation of a recording: one line, a table, a figure."""

from typing import TYPE_CHECKING

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_common.summary_table import SummaryTable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from piezo_recorder.reading.recording import Recording

SHOWN_PERIODS = 3
"""Number of periods of a fast signal in a close-up."""

MOST_REVERSALS = 40
"""Largest number of crossings of the mid voltage for which the whole recording is drawn."""

CROSSED = 0.1
"""Part of the swing around the mid voltage that a crossing must exceed, so that noise has none."""


def text_of(recording: "Recording") -> str:
    """Return a one-line description of a recording."""
    kinds = np.unique(recording.sample_periods_s)
    period = f"{kinds[0]:.4g} s" if kinds.size == 1 else f"{kinds[0]:.4g} to {kinds[-1]:.4g} s"
    gaps = f", {len(recording.gaps)} gaps" if recording.gaps else ""
    title = f" {recording.title}" if recording.title else ""
    return (f"<Recording {recording.path}{title}: {len(recording.sample_index)} samples every "
            f"{period}, {_range(recording.voltage_v)} V, "
            f"{_range(recording.displacement_um)} um{gaps}>")


def summary_of(recording: "Recording") -> SummaryTable:
    """Return the table of a recording: extent, clock, ranges, and problems."""
    periods_s = np.unique(recording.sample_periods_s)
    duration_s = float(recording.time_s[-1] + recording.sample_periods_s[-1])
    rows: list[tuple[str | float | None, ...]] = [
        ("samples", len(recording.sample_index), None, ""),
        ("duration", duration_s, None, "s"),
        ("sample period", float(periods_s[0]), float(periods_s[-1]), "s"),
        ("sample rate", float(1.0 / periods_s[-1]), float(1.0 / periods_s[0]), "Hz"),
        ("voltage", *_ends(recording.voltage_v), "V"),
        ("displacement", *_ends(recording.displacement_um), "um"),
        *_reference_rows(recording),
        ("missing samples", sum(missing for _, missing in recording.gaps), None, ""),
        *((f"column {name}", *_ends(values), "") for name, values in recording.columns.items()),
    ]
    rows = [(name, low, None if low == high else high, unit) for name, low, high, unit in rows]
    notes = () if recording.complete else ("The recorder was killed before it closed the file.",)
    return SummaryTable(f"Recording {recording.path} {recording.title}".rstrip(),
                        ("", "value, or lowest", "highest", "unit"), rows,
                        (*notes, *recording.notes))


def error_um(recording: "Recording") -> FloatArray:
    """Return reference minus displacement (um) of the samples that have a reference."""
    if not recording.reference_um.size:
        return np.empty(0)
    followed = np.isfinite(recording.reference_um)
    return np.asarray(recording.reference_um - recording.displacement_um, dtype=float)[followed]


def _reference_rows(recording: "Recording") -> list[tuple[str | float | None, ...]]:
    errors_um = error_um(recording)
    if not errors_um.size:
        return []
    followed = recording.reference_um[np.isfinite(recording.reference_um)]
    return [("reference", *_ends(followed), "um"),
            ("rms error, with the way to its beginning", float(np.sqrt(np.mean(errors_um**2))),
             None, "um")]


def draw_recording(recording: "Recording") -> "Figure":
    """Draw voltage and displacement over time, and the displacement over the voltage.

    For a tracking run the reference is drawn with the displacement, and the error below.

    If the voltage reverses so often that the whole recording would be a solid block, a few periods
    from the middle are drawn next to it, and only their loop is drawn.
    """
    from piezo_common.picture_style import WIDE_IN, label, new_figure

    close = close_look(np.asarray(recording.voltage_v, dtype=float))
    rows = 3 if recording.reference_um.size else 2
    figure = new_figure(2.3 * rows, WIDE_IN)
    grid = figure.add_gridspec(rows, 2 if close is None else 3)
    loop = figure.add_subplot(grid[:, -1])
    parts = [slice(None)] if close is None else [slice(None), close]
    for column, part in enumerate(parts):
        above = figure.add_subplot(grid[0, column])
        below = figure.add_subplot(grid[1, column], sharex=above)
        _draw_over_time(above, recording.time_s[part], recording.voltage_v[part])
        _draw_over_time(below, recording.time_s[part], recording.displacement_um[part])
        first = column == 0
        label(above, None, "voltage (V)" if first else None, "whole" if first else "close")
        label(below, "time (s)" if rows == 2 else None, "displacement (um)" if first else None)
        if rows == 3:
            error = figure.add_subplot(grid[2, column], sharex=above)
            _draw_tracking(below, error, recording, part)
            label(error, "time (s)", "error (nm)" if first else None)
        above.locator_params(axis="x", nbins=4)
    _draw_loop(loop, recording.voltage_v[parts[-1]], recording.displacement_um[parts[-1]])
    label(loop, "voltage (V)", "displacement (um)", "loop")
    return figure


def close_look(voltage_v: FloatArray) -> slice | None:
    """Return the samples of a few periods from the middle of a voltage, (N,).

    It is None if the voltage crosses its mid value so rarely that the whole can be drawn.
    """
    low_v, high_v = voltage_v.min(), voltage_v.max()
    part = (voltage_v - 0.5 * (low_v + high_v)) / max(high_v - low_v, np.finfo(float).tiny)
    clear = np.flatnonzero(np.abs(part) > CROSSED)
    passes = clear[1:][np.diff(np.sign(part[clear])) > 0]
    if passes.size <= MOST_REVERSALS // 2:
        return None
    middle = (passes.size - SHOWN_PERIODS) // 2
    begin, end = passes[middle], passes[middle + SHOWN_PERIODS]
    before = (end - begin) // (4 * SHOWN_PERIODS)
    return slice(int(begin - before), int(end - before))


def _draw_over_time(axes: "Axes", time_s: FloatArray, values: FloatArray) -> None:
    from piezo_common.picture_style import BLUE, outline

    axes.plot(*outline(time_s, values), color=BLUE, linewidth=0.9)


def _draw_tracking(displacement: "Axes", error: "Axes", recording: "Recording",
                   part: slice) -> None:
    from piezo_common.picture_style import ORANGE, outline

    reference_um = recording.reference_um[part]
    followed = np.isfinite(reference_um)
    if followed.any():
        time_s, reference_um = recording.time_s[part][followed], reference_um[followed]
        displacement.plot(*outline(time_s, reference_um), color=ORANGE, linestyle="--",
                          linewidth=0.9, label="reference")
        displacement.legend(loc="best")
        errors_um = reference_um - recording.displacement_um[part][followed]
        _draw_over_time(error, time_s, 1e3 * errors_um)


def _draw_loop(axes: "Axes", voltage_v: FloatArray, displacement_um: FloatArray) -> None:
    from piezo_common.picture_style import BLUE

    every = max(1, voltage_v.size // 20_000)
    axes.plot(voltage_v[::every], displacement_um[::every], color=BLUE, linewidth=0.7)


def _ends(values: FloatArray) -> tuple[float, float]:
    return float(np.min(values)), float(np.max(values))


def _range(values: FloatArray) -> str:
    low, high = _ends(values)
    return f"{low:.4g} to {high:.4g}"
