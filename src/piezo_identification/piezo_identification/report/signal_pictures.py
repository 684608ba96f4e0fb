# SPDX-License-Identifier: BSD-3-Clause
"""Draw measured and modelled signals in ways that suit each kind of waveform.

Signals have the shape (N,), and `noise_um` is the standard deviation of a single sample.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_common.picture_style import (
    BAND,
    BLUE,
    DIFFERENCE,
    GREY,
    LIMIT,
    MEASURED,
    MODELLED,
    MOST_POINTS,
    VERMILION,
    label,
    new_figure,
    outline,
    plain_numbers,
)
from piezo_common.report_page import Picture, pictured
from piezo_identification.analysis.gain_over_frequency import gain_of, spectrum
from piezo_identification.conditioning.means import means_in_bins
from piezo_identification.report.waveform_view import WaveformView, mean_hold

NANOMETRES = 1e3

SPECTRUM_CELLS = 1000
"""Most points of a spectrum drawn over the logarithm of frequency."""

CREEP_START_S = 0.03

ALONE: dict[str, Any] = {"color": BLUE, "linewidth": 1.0, "label": "measured"}
"""Line style of a measurement that is drawn without a model."""

ENVELOPE: dict[str, Any] = {"color": VERMILION, "linewidth": 0.5}


def draw_difference(axes: Axes, view: WaveformView, difference_um: FloatArray,
                    noise_um: float | None, deviation_um: FloatArray | None = None) -> None:
    """Draw the residual of a model with bands of two standard deviations of noise and model.

    The noise is reduced for a mean period. The deviation of the model is not drawn if it is 0.
    """
    if deviation_um is not None and deviation_um.any():
        band_nm = NANOMETRES * BAND * view.mean(deviation_um)
        x, high = outline(view.time, band_nm)
        axes.fill_between(x, -high, high, color=BLUE, alpha=0.2, linewidth=0.0,
                          label="outside the identification")
        axes.legend(loc="upper right")
    residual_nm = NANOMETRES * view.mean(difference_um)
    # Many points would merge into a solid block, so their envelope is drawn.
    style: dict[str, Any] = DIFFERENCE if residual_nm.size <= MOST_POINTS else ENVELOPE
    axes.plot(*outline(view.time, residual_nm), **style)
    if noise_um is not None and np.isfinite(noise_um):
        draw_noise(axes, noise_um / np.sqrt(view.periods))
    label(axes, view.time_label, "residual (nm)")


def picture_over_time(name: str, view: WaveformView, difference_um: FloatArray, noise_um: float,
                      deviation_um: FloatArray | None = None) -> Picture:
    """Return the residual of a model at all samples; see `draw_difference`."""
    figure = new_figure(3.4)
    draw_difference(figure.subplots(), view.whole(difference_um.size), difference_um, noise_um,
                    deviation_um)
    return pictured(name, figure, "Measured minus modelled displacement of all samples; dotted, "
                    "twice the noise, between which 95 % of it lies.", closer=True)


def time_figure(figure: Figure, view: WaveformView, measured_um: FloatArray,
                modelled_um: FloatArray, residual_um: FloatArray, noise_um: float | None,
                deviation_um: FloatArray | None = None) -> Figure:
    """Draw the mean period of a signal, or its envelope, with that of a model and the residual."""
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    above.plot(*outline(view.time, view.mean(measured_um)), **MEASURED)
    above.plot(*outline(view.time, view.mean(modelled_um)), **MODELLED)
    above.legend(loc="best")
    label(above, y="displacement (um)", title=view.title)
    draw_difference(below, view, residual_um, noise_um, deviation_um)
    return figure


def draw_noise(axes: Axes, noise_um: float) -> None:
    """Draw lines at plus and minus two standard deviations, which enclose 95 % of the noise."""
    for sign in -1.0, 1.0:
        axes.axhline(sign * BAND * NANOMETRES * noise_um, **LIMIT)


def draw_loops(axes: Axes, voltage_v: FloatArray, measured: FloatArray,
               modelled: FloatArray | None = None) -> None:
    """Draw signals over the voltage, thinned to few points."""
    every = slice(None, None, max(1, voltage_v.size // MOST_POINTS))
    axes.plot(voltage_v[every], measured[every], **(ALONE if modelled is None else MEASURED))
    if modelled is not None:
        axes.plot(voltage_v[every], modelled[every], **MODELLED)
        axes.legend(loc="upper left")
    label(axes, "voltage (V)", "displacement (um)")


def loops_figure(height_in: float, voltage_v: FloatArray, measured_um: FloatArray,
                 modelled_um: FloatArray, residual_um: FloatArray, noise_um: float) -> Figure:
    """Draw measured and modelled displacement, and the residual, over the voltage."""
    figure = new_figure(height_in)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    draw_loops(above, voltage_v, measured_um, modelled_um)
    above.set_xlabel("")
    every = slice(None, None, max(1, voltage_v.size // MOST_POINTS))
    below.plot(voltage_v[every], NANOMETRES * residual_um[every], **DIFFERENCE)
    if np.isfinite(noise_um):
        draw_noise(below, noise_um)
    label(below, "voltage (V)", "residual (nm)")
    return figure


def draw_creep(above: Axes, below: Axes, steps: NDArray[np.intp], voltage_v: FloatArray,
               measured_um: FloatArray, modelled_um: FloatArray, sample_period_s: float) -> None:
    """Draw the mean creep after steps, and the residual, over the logarithm of time.

    There is at least one step, given by the number of its sample.
    """
    since_s, (measured, modelled), count = mean_hold(
        steps, voltage_v, (measured_um, modelled_um), sample_period_s)
    start = int(np.searchsorted(since_s, max(CREEP_START_S, since_s[1])))
    shown = np.unique(np.geomspace(start, since_s.size - 1, MOST_POINTS).astype(int))
    for values, style in ((measured, MEASURED), (modelled, MODELLED)):
        above.semilogx(since_s[shown], values[shown] - modelled[start], **style)
    above.legend(loc="upper left")
    label(above, y="creep (um)", title=f"mean of {count} steps, falling ones turned round"
          if count > 1 else "after one step")
    residual_um = (measured - modelled)[shown]
    below.semilogx(since_s[shown], NANOMETRES * (residual_um - residual_um.mean()), **DIFFERENCE)
    label(below, "time since the step (s)", "residual (nm)")
    plain_numbers(below.xaxis)


def draw_step_response(axes: Axes, response: FloatArray, sample_period_s: float) -> None:
    """Draw the mean response to steps from `suitability.jump_response`."""
    axes.plot(1e3 * sample_period_s * np.arange(response.size), response, color=BLUE, marker=".",
              markersize=3, linewidth=1.0)
    axes.axhline(1.0, color=GREY, linewidth=0.8)
    label(axes, "time since the step (ms)", "part of the step (1)", "mean response to the steps")


def draw_gain(axes: Axes, voltage_v: FloatArray, measured_um: FloatArray, sample_period_s: float,
              modelled_um: FloatArray | None = None) -> None:
    """Draw the gain from voltage to displacement, also of a model, at the excited frequencies."""
    of_measured = ALONE if modelled_um is None else MEASURED
    for values, style in ((measured_um, of_measured), (modelled_um, MODELLED)):
        if values is not None:
            frequency_hz, response, _ = gain_of(voltage_v, values, sample_period_s)
            axes.loglog(frequency_hz, np.abs(response), **style)
    if modelled_um is not None:
        axes.legend(loc="lower left")
    label(axes, "frequency (Hz)", "gain (um/V)", "gain where the voltage excites")
    for axis in (axes.xaxis, axes.yaxis):
        plain_numbers(axis)


def draw_coherence(axes: Axes, voltage_v: FloatArray, measured_um: FloatArray,
                   sample_period_s: float) -> None:
    """Draw the coherence of voltage and displacement over frequency."""
    frequency_hz, _, coherence = gain_of(voltage_v, measured_um, sample_period_s)
    axes.semilogx(frequency_hz, coherence, color=BLUE, linewidth=1.0)
    axes.set_ylim(0.0, 1.05)
    label(axes, "frequency (Hz)", "coherence (1)", "part that goes with the voltage")
    plain_numbers(axes.xaxis)


def smoothed(frequency_hz: FloatArray, power: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Average a spectrum, (F,), without zero frequency, in cells of equal width in log frequency.

    It is unchanged if it has no more lines than cells.
    """
    if frequency_hz.size <= SPECTRUM_CELLS:
        return frequency_hz, power
    span = np.log(frequency_hz[-1] / frequency_hz[0])
    cell = np.floor(
        (SPECTRUM_CELLS - 1) * np.log(frequency_hz / frequency_hz[0]) / span).astype(int)
    centres, powers = means_in_bins(cell, frequency_hz, power)
    return centres, powers


def draw_densities(axes: Axes, signals_um: Iterable[tuple[FloatArray, dict[str, Any]]],
                   sample_period_s: float, noise_um: float) -> None:
    """Draw the spectral densities of signals, each with its style, and of white noise."""
    for signal_um, style in signals_um:
        frequency_hz, power = spectrum(signal_um, sample_period_s)
        frequency_hz, power = smoothed(frequency_hz[1:-1], power[1:-1])
        axes.loglog(frequency_hz, NANOMETRES * np.sqrt(power), **style)
    if noise_um > 0.0:
        floor = NANOMETRES * noise_um * np.sqrt(2.0 * sample_period_s)
        axes.axhline(floor, label="noise, if white", **LIMIT)
        axes.set_ylim(bottom=0.1 * floor)
    axes.legend(loc="best")
    label(axes, "frequency (Hz)", "density (nm per root Hz)")
    plain_numbers(axes.xaxis)


def picture_over_frequency(name: str, residual_um: FloatArray, measured_um: FloatArray,
                           sample_period_s: float, noise_um: float, source: str) -> Picture:
    """Return the spectral densities of residual, displacement and white noise from some source."""
    figure = new_figure(3.4)
    draw_densities(figure.subplots(), (
        (measured_um, MEASURED | {"linewidth": 1.2}),
        (residual_um, {"color": BLUE, "linewidth": 0.9, "label": "residual"})),
        sample_period_s, noise_um)
    return pictured(name, figure, "Density of the residual, and of the measured displacement; "
                    f"dotted, white noise as large as {source}.", closer=True)
