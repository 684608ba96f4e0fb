# SPDX-License-Identifier: BSD-3-Clause
"""Figures of a diagnosis, with the results before and after on the same axes."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from piezo_common.arrays import FloatArray
from piezo_common.picture_style import (
    AFTER,
    BEFORE,
    BLACK,
    MOST_POINTS,
    WIDE_IN,
    label,
    new_figure,
    outline,
    plain_numbers,
)
from piezo_identification.analysis.gain_over_frequency import gain_of, segment_of, spectrum
from piezo_identification.diagnosis.evidence.residual_tests import (
    dependences,
    input_correlation,
    whiteness,
)
from piezo_identification.fitting import noise_estimate
from piezo_identification.report.signal_pictures import draw_densities, draw_noise
from piezo_identification.simulation.simulated_recording import SimulatedRecording

if TYPE_CHECKING:
    from piezo_identification.diagnosis.diagnose import Diagnosis

MODEL = {"color": BLACK, "linewidth": 0.8}
CLOSE_SAMPLES = 800
MOST_PERCENT = 1000.0
"""Upper limit of the plotted errors."""


@dataclass(frozen=True, eq=False)
class Residuals:
    """A simulated recording, and the residuals of the given model and of the extended one."""

    part: SimulatedRecording

    before_um: FloatArray
    after_um: FloatArray
    """Residuals at all samples, (N,)."""
    noise_um: float
    """Standard deviation of the sensor noise."""

    def settled(self, signal: FloatArray) -> FloatArray:
        """Return the samples of a signal from which on the model has settled."""
        return signal[self.part.begin :]

    @property
    def both_um(self) -> tuple[FloatArray, FloatArray]:
        """Residuals before and after at these samples."""
        return self.settled(self.before_um), self.settled(self.after_um)

    @property
    def voltage_v(self) -> FloatArray:
        """Voltage at these samples."""
        return self.settled(self.part.voltage_v)

    @property
    def simulated_um(self) -> FloatArray:
        """Displacement of the given model at these samples."""
        return self.settled(self.part.simulate())


def residuals_of(diagnosis: "Diagnosis", index: int = 0) -> Figure:
    """Draw the residuals of one of the recordings of a diagnosis; see `draw_residuals`."""
    return draw_residuals(residuals_um(diagnosis, index))


def residuals_um(diagnosis: "Diagnosis", index: int) -> Residuals:
    """Return the residuals of one of the recordings of a diagnosis."""
    regression = diagnosis.selection.regression
    dataset, noise = regression.dataset, regression.noise
    return Residuals(
        dataset.simulated[index], noise_estimate.residual_um(dataset, index, noise=noise),
        noise_estimate.residual_of_model_um(dataset, index, diagnosis.model, noise),
        noise.noise_um[index])


def draw_residuals(residuals: Residuals) -> Figure:
    """Draw the residuals over time: the whole, and a detail where most was gained."""
    figure, part = new_figure(5.5, WIDE_IN), residuals.part
    columns = zip(
        figure.subplots(2, 2, height_ratios=(1, 2), width_ratios=(2, 1), sharex="col").T,
        (slice(part.begin, None), _closest_look(residuals)), strict=True,
    )
    for (above, below), shown in columns:
        above.plot(*outline(part.time_s[shown], part.voltage_v[shown]), **MODEL)
        below.plot(*outline(part.time_s[shown], 1e3 * residuals.before_um[shown]), **BEFORE)
        below.plot(*outline(part.time_s[shown], 1e3 * residuals.after_um[shown]), **AFTER)
        draw_noise(below, residuals.noise_um)
        label(above, y="voltage (V)")
        label(below, "time (s)", "residual (nm)")
    below.locator_params(axis="x", nbins=3)
    figure.legend(*below.get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def _closest_look(residuals: Residuals) -> slice:
    """Return the slice of samples in which the variance of the residual decreased most."""
    samples = min(CLOSE_SAMPLES, residuals.voltage_v.size)
    windows = residuals.voltage_v.size // samples
    before, after = (residual_um[: windows * samples].reshape(windows, samples).var(1)
                     for residual_um in residuals.both_um)
    start = residuals.part.begin + samples * int(np.argmax(before - after))
    return slice(start, start + samples)


def draw_spectra(residuals: Residuals) -> Figure:
    """Draw spectra of both residuals, of the model's displacement, and of white noise."""
    figure = new_figure(4.5, WIDE_IN)
    draw_densities(
        figure.subplots(), zip((residuals.simulated_um, *residuals.both_um),
                               (MODEL | {"label": "model"}, BEFORE, AFTER), strict=True),
        residuals.part.sample_period_s, residuals.noise_um)
    return figure


def draw_tests(residuals: Residuals) -> Figure:
    """Draw whiteness and correlation with the input, with the 99 % band."""
    figure = new_figure(5.0, WIDE_IN)
    above, below = figure.subplots(2)
    for residual_um, style in zip(residuals.both_um, (BEFORE, AFTER), strict=True):
        white = whiteness(residual_um)
        above.plot(white.lags, white.correlation, **style)
        with_input = input_correlation(residual_um, residuals.voltage_v)
        below.plot(with_input.lags, with_input.correlation, **style)
    for axes, test in ((above, white), (below, with_input)):
        axes.axhspan(-test.band, test.band, color="0.85")
    label(above, "lag (samples)", "correlation with itself")
    label(below, "lag (samples)", "with the voltage")
    above.legend(loc="upper right")
    return figure


def draw_over_voltage(residuals: Residuals) -> Figure:
    """Draw the residuals over the voltage, where errors of a loop form loops."""
    figure = new_figure(4.5, WIDE_IN)
    axes = figure.subplots()
    every = slice(None, None, max(1, residuals.part.time_s.size // MOST_POINTS))
    points: dict[str, Any] = {"linestyle": "none", "marker": "."}
    for residual_um, style, size in zip(
            residuals.both_um, (BEFORE, AFTER), (4, 2), strict=True):
        axes.plot(residuals.voltage_v[every], 1e3 * residual_um[every],
                  **(style | points | {"markersize": size}))
    draw_noise(axes, residuals.noise_um)
    label(axes, "voltage (V)", "residual (nm)")
    axes.legend(loc="upper left")
    return figure


def draw_error_response(residuals: Residuals) -> Figure:
    """Draw the ratio of residual and displacement at frequencies where they are coherent.

    Frequencies at which the displacement is below the noise are omitted, because the ratio is large
    there for any residual.
    """
    figure = new_figure(4.5, WIDE_IN)
    axes = figure.subplots()
    simulated_um, period_s = residuals.simulated_um, residuals.part.sample_period_s
    segment = segment_of(simulated_um.size)
    # Independent signals are more coherent at one line in a hundred.
    limit = 1.0 - 0.01 ** (1.0 / (max(2, simulated_um.size // segment) - 1))
    density = spectrum(simulated_um, period_s)
    for residual_um, style in zip(residuals.both_um, (BEFORE, AFTER), strict=True):
        frequency_hz, gain, coherence = gain_of(
            simulated_um, residual_um, period_s, segment, least_power=0.0)
        moves = np.interp(frequency_hz, *density) > 2.0 * period_s * residuals.noise_um**2
        percent = np.where((coherence > limit) & moves, 100.0 * np.abs(gain), np.nan)
        every = slice(None, None, max(1, percent.size // MOST_POINTS))
        axes.loglog(frequency_hz[every], np.minimum(percent, MOST_PERCENT)[every], **style)
    label(axes, "frequency (Hz)", "part of the displacement (%)")
    for axis in axes.xaxis, axes.yaxis:
        plain_numbers(axis)
    axes.legend(loc="upper left")
    return figure


def draw_dependences(residuals: Residuals) -> Figure:
    """Draw the mean residual over each quantity that may be related to an effect."""
    figure = new_figure(6.0, WIDE_IN)
    for residual_um, style in zip(residuals.both_um, (BEFORE, AFTER), strict=True):
        found = dependences(residual_um, residuals.simulated_um, residuals.voltage_v,
                            residuals.settled(residuals.part.time_s))
        axes = figure.axes or figure.subplots(2, 3).ravel()
        for one, dependence in zip(axes, found, strict=True):
            one.plot(dependence.centre, 1e3 * dependence.mean_um, marker=".", **style)
            one.fill_between(dependence.centre, -1e3 * dependence.band_um,
                             1e3 * dependence.band_um, color=style["color"], alpha=0.15)
            label(one, dependence.quantity, "mean residual (nm)")
    return figure
