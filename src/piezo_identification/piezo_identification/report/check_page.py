# SPDX-License-Identifier: BSD-3-Clause
"""The page and the figure of a check: what was measured in a recording, and its possible uses."""

from collections.abc import Sequence
from html import escape

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from piezo_common.arrays import FloatArray
from piezo_common.picture_style import BLUE, CURVES, ORANGE, WIDE_IN, label, new_figure, outline
from piezo_common.report_page import Section, pictured, render_page
from piezo_identification.analysis.gain_over_frequency import spectrum
from piezo_identification.recording_check.check import RecordingCheck
from piezo_identification.recording_check.check_report import measured_rows
from piezo_identification.recording_check.suitability import Suitability, jump_response
from piezo_identification.recording_check.waveform_kind import Kind
from piezo_identification.report import signal_pictures as signals
from piezo_identification.report.waveform_view import WaveformView, view_of


def check_page(
    checks: Sequence[tuple[str, RecordingCheck, dict[str, Suitability], Figure]],
) -> str:
    """Return the page of one check or several as HTML.

    Each has the title of the recording, what was measured, its suitability for each experiment, and
    its figure from `check_figure`.
    """
    count = len(checks)
    title = (checks[0][0] + ": " + suitability_sentence(checks[0][2])) if count == 1 else (
        f"What {count} recordings can be used for")
    sections = [section for name, check, fit_for, figure in checks for section in _sections(
        name, f"{name}: {suitability_sentence(fit_for)}" if count > 1 else "What it can stand for",
        check, fit_for, figure)]
    return render_page(title, [
        "The noise is the lowest estimate from rests, repeats and the highest frequencies. "
        "The drift is that at one voltage over the whole recording."], sections)


def suitability_sentence(fit_for: dict[str, Suitability]) -> str:
    """Return a phrase that lists the experiments for which a recording is suitable."""
    by_verdict = {verdict: [name for name, each in fit_for.items() if each.verdict == verdict]
                  for verdict in ("yes", "partly")}
    parts = []
    if by_verdict["yes"]:
        parts.append(f"good for {', '.join(by_verdict['yes'])}")
    if by_verdict["partly"]:
        parts.append(f"partly for {', '.join(by_verdict['partly'])}")
    return "; ".join(parts) or "good for none of the experiments"


def _sections(name: str, title: str, check: RecordingCheck,
              fit_for: dict[str, Suitability], figure: Figure) -> list[Section]:
    good_for = [("can stand for", "verdict", "because"),
                *((experiment, each.verdict, each.reason)
                  for experiment, each in fit_for.items())]
    rows = [("measured", "value"), *measured_rows(check)]
    return [
        Section(title, check.warnings, good_for, [
            pictured(name, figure, "Displacement and voltage over time; below, what "
                     f"a voltage of this kind shows ({escape(check.waveform.kind)}).",
                     wide=True, closer=True)]),
        Section("What was measured", table=rows)]


def check_figure(check: RecordingCheck) -> Figure:
    """Draw a recording over time, with plots that suit its kind of waveform.

    The mean period of a periodic voltage is drawn, and the envelope of a long recording. For steps,
    the mean response and the ends of the levels are added; for slow cycles, the loop and the
    visited part of the Preisach plane; for broadband voltages, gain and coherence over frequency;
    for a constant voltage, spectrum and histogram of the noise. For a tracking run, the reference
    is drawn over the displacement, and the error below.
    """
    tracked = bool(np.isfinite(check.reference_um).any())
    heights = (2, 1, 1, 3) if tracked else (2, 1, 3)
    figure = new_figure(height_in=7.6 if tracked else 6.4, width_in=WIDE_IN)
    grid = figure.add_gridspec(len(heights), 2, height_ratios=heights)
    time = figure.add_subplot(grid[0, :])
    below = figure.add_subplot(grid[-2, :], sharex=time)
    left, right = figure.add_subplot(grid[-1, 0]), figure.add_subplot(grid[-1, 1])
    voltage_v, displacement_um = check.voltage_v, check.displacement_um
    period_s = check.sample_period_s
    view = view_of(voltage_v, period_s, check.waveform)
    _draw_time(time, below, view, voltage_v, displacement_um)
    if tracked:
        _draw_tracking(time, figure.add_subplot(grid[1, :], sharex=time), view, check)
    if check.waveform.kind.has_levels:
        signals.draw_step_response(
            left, jump_response(voltage_v, displacement_um, check.waveform.jumps), period_s)
        (_draw_drift if check.waveform.kind is Kind.SQUARE else _draw_levels)(right, check)
    elif check.waveform.kind.is_broadband:
        signals.draw_gain(left, voltage_v, displacement_um, period_s)
        signals.draw_coherence(right, voltage_v, displacement_um, period_s)
    elif check.waveform.kind is Kind.CONSTANT:
        _draw_spectrum(left, displacement_um, period_s)
        _draw_histogram(right, displacement_um)
    else:
        signals.draw_loops(left, view.mean(voltage_v), view.mean(displacement_um))
        left.set_title(f"loop, {view.title}", fontsize="medium")
        _draw_plane(right, check)
    return figure


def _draw_time(above: Axes, below: Axes, view: WaveformView, voltage_v: FloatArray,
               displacement_um: FloatArray) -> None:
    above.plot(*outline(view.time, view.mean(displacement_um)), color=BLUE, linewidth=1.0,
               label="displacement")
    label(above, y="displacement (um)", title=view.title)
    above.tick_params(labelbottom=False)
    below.plot(*outline(view.time, view.mean(voltage_v)), color=ORANGE, linewidth=1.0,
               label="voltage")
    label(below, view.time_label, "voltage (V)")


def _draw_tracking(above: Axes, between: Axes, view: WaveformView, check: RecordingCheck) -> None:
    """Draw the reference over the displacement, and the tracking error."""
    reference_um = view.mean(check.reference_um)
    known = np.isfinite(reference_um)
    error_um = reference_um - view.mean(check.displacement_um)
    above.plot(*outline(view.time[known], reference_um[known]), color=ORANGE, linestyle="--",
               linewidth=0.9, label="reference")
    above.legend(loc="best")
    between.plot(*outline(view.time[known], 1e3 * error_um[known]), color=BLUE, linewidth=0.9,
                 label="error")
    between.tick_params(labelbottom=False)
    label(between, y="error (nm)")


def _draw_levels(axes: Axes, check: RecordingCheck) -> None:
    """Draw the displacement at the end of each level: the loop of a voltage that jumps."""
    ends = np.append(check.waveform.jumps, check.voltage_v.size) - 1
    axes.plot(check.voltage_v[ends], check.displacement_um[ends], color=BLUE, marker="o",
              markersize=3, linewidth=0.7)
    label(axes, "voltage (V)", "displacement (um)", "where each level ends")


def _draw_drift(axes: Axes, check: RecordingCheck) -> None:
    """Draw the displacement at the end of each hold of a square wave, relative to the first."""
    ends = check.waveform.jumps - 1
    high = check.voltage_v[ends] > check.voltage_v.mean()
    for of_level, name, style in ((high, "upper level", CURVES[0]), (~high, "lower level",
                                                                    CURVES[1])):
        at = ends[of_level]
        if at.size:
            axes.plot(at * check.sample_period_s,
                      1e3 * (check.displacement_um[at] - check.displacement_um[at[0]]),
                      label=name, **style)
    axes.legend(loc="best")
    label(axes, "time (s)", "change (nm)", "ends of the holds")


def _draw_plane(axes: Axes, check: RecordingCheck) -> None:
    low_v, high_v = check.recording.voltage_v.min(), check.recording.voltage_v.max()
    shown = np.where(np.tril(np.ones_like(check.visited)), check.visited.astype(float), np.nan)
    axes.imshow(shown, origin="lower", extent=(low_v, high_v, low_v, high_v), cmap="Blues",
                vmin=-0.3, vmax=1.3, interpolation="nearest")
    label(axes, "switches down at (V)", "switches up at (V)",
          f"Preisach plane: {100.0 * check.visited_fraction:.0f} % visited (dark)")


def _draw_spectrum(axes: Axes, displacement_um: FloatArray, period_s: float) -> None:
    frequency_hz, power = spectrum(displacement_um, period_s)
    if power[1:].any():
        axes.loglog(frequency_hz[1:], np.sqrt(power[1:]), color=BLUE, linewidth=1.0)
    label(axes, "frequency (Hz)", "noise (um/sqrt(Hz))", "spectrum of the displacement")


def _draw_histogram(axes: Axes, displacement_um: FloatArray) -> None:
    axes.hist(displacement_um, bins=60, color=BLUE)
    label(axes, "displacement (um)", "samples (1)", "distribution of the displacement")
