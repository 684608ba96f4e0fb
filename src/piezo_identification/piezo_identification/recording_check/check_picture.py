# SPDX-License-Identifier: BSD-3-Clause
"""The picture of a check: the recording over time, and what its kind of waveform shows best."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from scipy.signal import csd, welch

from piezo_common.arrays import FloatArray
from piezo_common.picture_style import (
    BLUE,
    GREY,
    ORANGE,
    WIDE_IN,
    label,
    new_figure,
    plain_numbers,
    to_png,
)
from piezo_identification.recording_check.check import RecordingCheck
from piezo_identification.recording_check.suitability import jump_response
from piezo_identification.recording_check.waveform_kind import BROADBAND, LEVELS

MOST_POINTS = 4000
"""Points of a line; of longer signals the lowest and highest in each stretch are drawn."""

LINES = 2048
"""Samples of which a spectrum is estimated."""


def draw_check(path: Path, check: RecordingCheck) -> None:
    """Draw a check as a PNG.

    Steps show their mean response, slow cycles the loop and the visited part of the Preisach
    plane, broadband voltages the gain over frequency, a constant voltage the spectrum of the noise.

    Parameters
    ----------
    path : Path
    check : RecordingCheck
    """
    figure = new_figure(height_in=5.6, width_in=WIDE_IN)
    grid = figure.add_gridspec(2, 2)
    time, left, right = (figure.add_subplot(grid[0, :]), figure.add_subplot(grid[1, 0]),
                         figure.add_subplot(grid[1, 1]))
    recording = check.recording
    voltage_v = np.asarray(recording.voltage_v, dtype=float)
    displacement_um = np.asarray(recording.displacement_um, dtype=float)
    _draw_time(time, recording.time_s, voltage_v, displacement_um)
    period_s = float(np.median(recording.sample_periods_s))
    kind = check.waveform.kind
    if kind in LEVELS:
        _draw_response(left, jump_response(voltage_v, displacement_um, check.waveform.jumps),
                       period_s)
        _draw_loop(right, voltage_v, displacement_um)
    elif kind in BROADBAND:
        _draw_gain(left, voltage_v, displacement_um, period_s)
        _draw_loop(right, voltage_v, displacement_um)
    elif kind == "constant":
        _draw_spectrum(left, displacement_um, period_s)
        _draw_histogram(right, displacement_um)
    else:
        _draw_loop(left, voltage_v, displacement_um)
        _draw_plane(right, check)
    path.write_bytes(to_png(figure, 110.0))


def _outline(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a line of few points that looks like the whole."""
    if x.size <= MOST_POINTS:
        return x, y
    stretch = -(-2 * x.size // MOST_POINTS)
    count = x.size // stretch
    parts = y[: count * stretch].reshape(count, stretch)
    both = np.column_stack([parts.min(axis=1), parts.max(axis=1)]).ravel()
    return np.repeat(x[: count * stretch : stretch], 2), both


def _draw_time(axes: Axes, time_s: FloatArray, voltage_v: FloatArray,
               displacement_um: FloatArray) -> None:
    axes.plot(*_outline(time_s, displacement_um), color=BLUE, linewidth=1.0)
    label(axes, "time (s)", "displacement (um)", "displacement (dark) and voltage (light)")
    beside = axes.twinx()
    beside.plot(*_outline(time_s, voltage_v), color=ORANGE, linewidth=0.8, alpha=0.8)
    beside.set_ylabel("voltage (V)")
    beside.spines["top"].set_visible(False)


def _draw_loop(axes: Axes, voltage_v: FloatArray, displacement_um: FloatArray) -> None:
    every = max(1, voltage_v.size // 20_000)
    axes.plot(voltage_v[::every], displacement_um[::every], color=BLUE, linewidth=0.7)
    label(axes, "voltage (V)", "displacement (um)", "loop")


def _draw_plane(axes: Axes, check: RecordingCheck) -> None:
    low_v, high_v = check.recording.voltage_v.min(), check.recording.voltage_v.max()
    shown = np.where(np.tril(np.ones_like(check.visited)), check.visited.astype(float), np.nan)
    axes.imshow(shown, origin="lower", extent=(low_v, high_v, low_v, high_v), cmap="Blues",
                vmin=-0.3, vmax=1.3, interpolation="nearest")
    label(axes, "switches down at (V)", "switches up at (V)",
          f"Preisach plane: {100.0 * check.visited_fraction:.0f} % visited (dark)")


def _draw_response(axes: Axes, response: FloatArray, period_s: float) -> None:
    axes.plot(1e3 * period_s * np.arange(response.size), response, color=BLUE, marker=".",
              markersize=3, linewidth=1.0)
    axes.axhline(1.0, color=GREY, linewidth=0.8)
    label(axes, "time since the step (ms)", "part of the step", "mean response to the steps")


def _draw_gain(axes: Axes, voltage_v: FloatArray, displacement_um: FloatArray,
               period_s: float) -> None:
    lines = min(LINES, voltage_v.size)
    frequency_hz, crossed = csd(voltage_v, displacement_um, 1.0 / period_s, nperseg=lines)
    _, power = welch(voltage_v, 1.0 / period_s, nperseg=lines)
    excited = power > 1e-4 * power.max()
    excited[0] = False
    axes.loglog(frequency_hz[excited], np.abs(crossed[excited]) / power[excited], color=BLUE,
                linewidth=1.0)
    label(axes, "frequency (Hz)", "gain (um/V)", "gain where the voltage excites")
    for axis in (axes.xaxis, axes.yaxis):
        plain_numbers(axis)


def _draw_spectrum(axes: Axes, displacement_um: FloatArray, period_s: float) -> None:
    frequency_hz, power = welch(displacement_um, 1.0 / period_s,
                                nperseg=min(LINES, displacement_um.size))
    axes.loglog(frequency_hz[1:], np.sqrt(power[1:]), color=BLUE, linewidth=1.0)
    label(axes, "frequency (Hz)", "noise (um/sqrt(Hz))", "spectrum of the displacement")


def _draw_histogram(axes: Axes, displacement_um: FloatArray) -> None:
    axes.hist(displacement_um, bins=60, color=BLUE)
    label(axes, "displacement (um)", "samples", "distribution of the displacement")
