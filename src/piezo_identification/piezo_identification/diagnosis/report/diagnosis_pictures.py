# SPDX-License-Identifier: BSD-3-Clause
"""Figures of a diagnosis, with the results before and after on the same axes.

Residuals have the shape (N,); `noise_um` is the standard deviation of the sensor noise.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from piezo_common.arrays import FloatArray
from piezo_common.picture_style import (
    AFTER,
    BEFORE,
    BLACK,
    LIMIT,
    MOST_POINTS,
    WIDE_IN,
    label,
    new_figure,
    outline,
    plain_numbers,
)
from piezo_identification.diagnosis.evidence.residual_tests import (
    dependences,
    error_response,
    input_correlation,
    spectrum,
    whiteness,
)
from piezo_identification.fitting import noise_estimate
from piezo_identification.report.signal_pictures import draw_noise, smoothed
from piezo_identification.simulation.simulated_recording import SimulatedRecording

if TYPE_CHECKING:
    from piezo_identification.diagnosis.diagnose import Diagnosis

MODEL = {"color": BLACK, "linewidth": 0.8}
CLOSE_SAMPLES = 800
LOWEST_SHOWN = 0.1
"""Lower limit of spectra, relative to the noise."""

MOST_PERCENT = 1000.0
"""Upper limit of the plotted errors."""


def residuals_of(diagnosis: "Diagnosis", index: int = 0) -> Figure:
    """Draw the residuals of one of the recordings of a diagnosis; see `draw_residuals`."""
    return draw_residuals(*residuals_um(diagnosis, index))


def residuals_um(diagnosis: "Diagnosis", index: int,
                 ) -> tuple[SimulatedRecording, FloatArray, FloatArray, float]:
    """Return a recording, its residuals before and after, and the standard deviation of noise."""
    regression = diagnosis.selection.regression
    dataset, noise = regression.dataset, regression.noise
    return (dataset.simulated[index], noise_estimate.residual_um(dataset, index, noise=noise),
            noise_estimate.residual_of_model_um(dataset, index, diagnosis.model, noise),
            noise.noise_um[index])


def draw_residuals(part: SimulatedRecording, before_um: FloatArray, after_um: FloatArray,
                   noise_um: float) -> Figure:
    """Draw the residuals over time: the whole, and a detail where most was gained."""
    figure = new_figure(5.5, WIDE_IN)
    whole = slice(part.begin, None)
    columns = zip(
        figure.subplots(2, 2, height_ratios=(1, 2), width_ratios=(2, 1), sharex="col").T,
        (whole, _closest_look(part, before_um, after_um)), strict=True,
    )
    for (above, below), shown in columns:
        above.plot(*outline(part.time_s[shown], part.voltage_v[shown]), **MODEL)
        below.plot(*outline(part.time_s[shown], 1e3 * before_um[shown]), **BEFORE)
        below.plot(*outline(part.time_s[shown], 1e3 * after_um[shown]), **AFTER)
        draw_noise(below, noise_um)
        label(above, y="voltage (V)")
        label(below, "time (s)", "residual (nm)")
    below.locator_params(axis="x", nbins=3)
    figure.legend(*below.get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def _closest_look(part: SimulatedRecording, before_um: FloatArray, after_um: FloatArray) -> slice:
    """Return the slice of samples in which the variance of the residual decreased most."""
    samples = min(CLOSE_SAMPLES, before_um.size - part.begin)
    windows = (before_um.size - part.begin) // samples
    scatters = [
        residual_um[part.begin : part.begin + windows * samples].reshape(windows, samples).var(1)
        for residual_um in (before_um, after_um)
    ]
    start = part.begin + samples * int(np.argmax(scatters[0] - scatters[1]))
    return slice(start, start + samples)


def draw_spectra(part: SimulatedRecording, before_um: FloatArray, after_um: FloatArray,
                 noise_um: float) -> Figure:
    """Draw spectra of both residuals, of the model's displacement, and of white noise."""
    figure = new_figure(4.5, WIDE_IN)
    axes = figure.subplots()
    signals = (
        (part.simulate(), MODEL | {"label": "model"}),
        (before_um, BEFORE), (after_um, AFTER),
    )
    for signal, style in signals:
        frequency_hz, density = spectrum(signal[part.begin :], part.sample_period_s)
        frequency_hz, density = smoothed(frequency_hz[1:-1], density[1:-1])
        axes.loglog(frequency_hz, np.sqrt(density) * 1e3, **style)
    noise = 1e3 * noise_um * np.sqrt(2.0 * part.sample_period_s)
    axes.axhline(noise, label="noise", **LIMIT)
    axes.set_ylim(bottom=LOWEST_SHOWN * noise)
    label(axes, "frequency (Hz)", "density (nm per root Hz)")
    axes.legend(loc="lower left")
    return figure


def draw_tests(part: SimulatedRecording, before_um: FloatArray, after_um: FloatArray) -> Figure:
    """Draw whiteness and correlation with the input, with the 99 % band."""
    figure = new_figure(5.0, WIDE_IN)
    above, below = figure.subplots(2)
    for residual_um, style in ((before_um, BEFORE), (after_um, AFTER)):
        residual_um = residual_um[part.begin :]
        white = whiteness(residual_um)
        above.plot(white.lags, white.correlation, **style)
        with_input = input_correlation(residual_um, part.voltage_v[part.begin :])
        below.plot(with_input.lags, with_input.correlation, **style)
    for axes, test in ((above, white), (below, with_input)):
        axes.axhspan(-test.band, test.band, color="0.85")
    label(above, "lag (samples)", "correlation with itself")
    label(below, "lag (samples)", "with the voltage")
    above.legend(loc="upper right")
    return figure


def draw_over_voltage(part: SimulatedRecording, before_um: FloatArray, after_um: FloatArray,
                      noise_um: float) -> Figure:
    """Draw the residuals over the voltage, where errors of a loop form loops."""
    figure = new_figure(4.5, WIDE_IN)
    axes = figure.subplots()
    every = slice(part.begin, None, max(1, part.time_s.size // MOST_POINTS))
    points: dict[str, Any] = {"linestyle": "none", "marker": "."}
    for residual_um, style in ((before_um, BEFORE | points | {"markersize": 4}),
                               (after_um, AFTER | points | {"markersize": 2})):
        axes.plot(part.voltage_v[every], 1e3 * residual_um[every], **style)
    draw_noise(axes, noise_um)
    label(axes, "voltage (V)", "residual (nm)")
    axes.legend(loc="upper left")
    return figure


def draw_error_response(part: SimulatedRecording, before_um: FloatArray, after_um: FloatArray,
                        noise_um: float) -> Figure:
    """Draw the ratio of residual and displacement at frequencies where they are coherent.

    Frequencies at which the displacement is below the noise are omitted, because the ratio is large
    there for any residual.
    """
    figure = new_figure(4.5, WIDE_IN)
    axes = figure.subplots()
    simulated_um = part.simulate()[part.begin :]
    _, power = spectrum(simulated_um, part.sample_period_s)
    stands_out = power[1:-1] > 2.0 * part.sample_period_s * noise_um**2
    for residual_um, style in ((before_um, BEFORE), (after_um, AFTER)):
        found = error_response(residual_um[part.begin :], simulated_um, part.sample_period_s)
        significant = (found.coherence > found.limit) & stands_out
        percent = np.where(significant, 100.0 * np.abs(found.gain), np.nan)
        every = slice(None, None, max(1, percent.size // MOST_POINTS))
        axes.loglog(found.frequency_hz[every], np.minimum(percent, MOST_PERCENT)[every], **style)
    label(axes, "frequency (Hz)", "part of the displacement (%)")
    for axis in axes.xaxis, axes.yaxis:
        plain_numbers(axis)
    axes.legend(loc="upper left")
    return figure


def draw_dependences(part: SimulatedRecording, before_um: FloatArray,
                     after_um: FloatArray) -> Figure:
    """Draw the mean residual over each quantity that may be related to an effect."""
    figure = new_figure(6.0, WIDE_IN)
    for residual_um, style in ((before_um, BEFORE), (after_um, AFTER)):
        found = dependences(
            residual_um[part.begin :], part.simulate()[part.begin :],
            part.voltage_v[part.begin :], part.time_s[part.begin :],
        )
        axes = figure.axes or figure.subplots(2, 3).ravel()
        for one, dependence in zip(axes, found, strict=True):
            one.plot(dependence.centre, 1e3 * dependence.mean_um, marker=".", **style)
            one.fill_between(dependence.centre, -1e3 * dependence.band_um,
                             1e3 * dependence.band_um, color=style["color"], alpha=0.15)
            label(one, dependence.quantity, "mean residual (nm)")
    return figure
