# SPDX-License-Identifier: BSD-3-Clause
"""Figures that compare an identified model with the recordings it was estimated from."""

from collections.abc import Iterator

import numpy as np
from matplotlib.figure import Figure

from piezo_common.arrays import ComplexArray, FloatArray, IntArray
from piezo_common.picture_style import BLACK, MEASURED, MODELLED, label, new_figure, plain_numbers
from piezo_common.report_page import Picture, pictured
from piezo_identification.adequacy.component_residual import ComponentResidual
from piezo_identification.adequacy.lack_of_fit import LackOfFit
from piezo_identification.analysis.gain_over_frequency import gain_of
from piezo_identification.report import signal_pictures as signals
from piezo_identification.report.component_evidence import ComponentEvidence
from piezo_models.cascade import StageModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_pictures import density_on, draw_bode, drawn_frequencies
from piezo_models.model_summary import visited_fraction

FIT_HEIGHT_IN = 6.4
"""Height of the figure of a fit, about that of the two figures next to it."""

POINTS = 500

CLEARANCE = 10.0
"""Smallest ratio of a line to the noise for which the line is used."""

COHERENT = 0.9
MOST_MEASURED = 300


def component_pictures(evidence: ComponentEvidence) -> Iterator[Picture]:
    """Yield the fit of a component with its recording, and its residual over time and frequency."""
    name, residual = evidence.name, evidence.residual
    yield fit_picture(evidence)
    if evidence.is_response:
        return
    yield signals.picture_over_time(f"Residual of the {name} over time", evidence.view,
                                    evidence.residual_um, evidence.noise_um)
    yield signals.picture_over_frequency(
        f"Residual of the {name} over frequency", evidence.residual_um, residual.measured_um,
        residual.sample_period_s, evidence.noise_um,
        f"that estimated from {evidence.fit.noise_from}")


def fit_picture(evidence: ComponentEvidence) -> Picture:
    """Return the fit of a component with its recording."""
    name = f"Fit of the {evidence.name}"
    if evidence.is_response:
        return pictured(name, _response(evidence), "Measured frequency response at the travel of "
                        "the model, the fit, and the residual.", closer=True)
    shown, caption = _fit(evidence)
    return pictured(name, shown, caption, tall=True, closer=True)


def _fit(evidence: ComponentEvidence) -> tuple[Figure, str]:
    """Return a figure of the fit that suits the kind of waveform, and its caption."""
    residual, view = evidence.residual, evidence.view
    if evidence.component == "creep" and residual.steps.size:
        figure = new_figure(FIT_HEIGHT_IN)
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
        signals.draw_creep(above, below, residual.steps, residual.voltage_v, residual.measured_um,
                           evidence.fitted_um, residual.sample_period_s)
        return figure, ("Mean creep after the steps, measured and modelled; below, the residual "
                        "without its mean.")
    if evidence.component == "hysteresis" and not view.has_levels and (
            not view.kind.is_broadband):
        return signals.loops_figure(
            FIT_HEIGHT_IN, residual.voltage_v, residual.measured_um, evidence.fitted_um,
            evidence.residual_um, evidence.noise_um
        ), "Loops, measured and modelled; below, the residual, and twice the noise."
    of_mean = ", and twice the noise in a mean of so many periods" if view.is_mean else ""
    return signals.time_figure(
        new_figure(FIT_HEIGHT_IN), view, residual.measured_um, evidence.fitted_um,
        evidence.residual_um, evidence.noise_um
    ), f"Measured and modelled, {view.title}; below, the residual{of_mean}."


def _response(evidence: ComponentEvidence) -> Figure:
    residual = evidence.residual
    assert residual.frequency_hz is not None
    half = residual.frequency_hz.size // 2
    measured, fitted, residuals = (values[:half] + 1j * values[half:] for values in (
        residual.measured_um, evidence.fitted_um, residual.residual_um))
    figure = new_figure(4.4)
    axes = figure.subplots()
    for values, style in ((measured, MEASURED), (fitted, MODELLED),
                          (residuals, {"color": BLACK, "linewidth": 0.8, "label": "residual"})):
        axes.loglog(residual.frequency_hz[:half], np.abs(values), **style)
    axes.legend(loc="lower left")
    label(axes, "frequency (Hz)", "magnitude (um)")
    plain_numbers(axes.xaxis)
    return figure


def bode_picture(identified: IdentifiedModel, evidence: ComponentEvidence | None) -> Picture:
    """Return gain and phase of the linear part with uncertainty band and measured response."""
    figure = new_figure(5.0)
    gain, phase = figure.subplots(2, 1, sharex=True)
    measured = None if evidence is None else _measured_response(
        identified.model, evidence.residual, evidence.fit)
    period_s = None if evidence is None or evidence.is_response else (
        evidence.residual.sample_period_s)
    measured_hz = None if measured is None else measured[0]
    frequency_hz = _shown_frequencies(identified.model, period_s, measured_hz)
    draw_bode(gain, phase, identified, frequency_hz, measured)
    return pictured(
        "Frequency response", figure, "From the output of the hysteresis to the displacement. The "
        "band is that of twice the standard deviations of the parameters, taken for independent; "
        "it does not include errors of the model's structure.", tall=True, closer=True)


def density_picture(identified: IdentifiedModel) -> Picture:
    """Return a figure of the density of the hysteresis, with unvisited cells hatched."""
    figure = new_figure(4.6)
    axes = figure.subplots()
    density_on(axes, identified.model.hysteresis, identified.visited)
    axes.set_aspect("equal")
    visited = identified.visited
    coverage = ""
    if visited is not None:
        coverage = f" The recordings visited {100.0 * visited_fraction(visited):.0f} % of the plane"
        coverage += "." if np.all(visited[np.tril_indices(len(visited))]) else (
            "; in the hatched rest the density is a continuation.")
    return pictured("Density", figure, "Density of the relays over the voltages at which they "
                    f"switch.{coverage}", tall=True, closer=True)


def _measured_response(
    model: StageModel, residual: ComponentResidual, fit: LackOfFit,
) -> tuple[FloatArray, ComplexArray]:
    """Return frequencies, (M,), and the measured response, (M,), of the linear part of a model.

    It is the response of the model times the response from fitted to measured displacement. It is
    thus valid for any waveform; offset and gain of the hysteresis are those of the fit.
    """
    fitted_um = residual.measured_um - residual.residual_um
    frequency_hz: FloatArray
    ratio: ComplexArray
    if residual.frequency_hz is not None:
        half = residual.frequency_hz.size // 2
        frequency_hz = residual.frequency_hz[:half]
        ratio = np.asarray(
            (residual.measured_um[:half] + 1j * residual.measured_um[half:])
            / (fitted_um[:half] + 1j * fitted_um[half:]), dtype=complex)
    elif residual.period and residual.measured_um.size >= 2 * residual.period:
        period = residual.period
        repeats = fitted_um.size // period
        fitted, measured = (np.fft.rfft(values[: repeats * period].reshape(repeats, period).mean(0))
                            for values in (fitted_um, residual.measured_um))
        clear = np.abs(fitted) > CLEARANCE * fit.noise_rms_um * np.sqrt(period)
        clear[0] = False
        frequency_hz = np.fft.rfftfreq(period, residual.sample_period_s)[clear]
        ratio = measured[clear] / fitted[clear]
    else:
        frequency_hz, ratio, coherence = gain_of(
            fitted_um, residual.measured_um, residual.sample_period_s)
        frequency_hz, ratio = frequency_hz[coherence > COHERENT], ratio[coherence > COHERENT]
    kept = _thinned(frequency_hz)
    return frequency_hz[kept], ratio[kept] * model.response(frequency_hz[kept])


def _thinned(frequency_hz: FloatArray) -> IntArray:
    """Return the indices of the frequencies to draw, about evenly spaced in their logarithm."""
    if frequency_hz.size <= MOST_MEASURED:
        return np.arange(frequency_hz.size)
    cells = np.floor(np.log(frequency_hz / frequency_hz[0])
                     / np.log(frequency_hz[-1] / frequency_hz[0]) * MOST_MEASURED)
    return np.asarray(np.unique(cells, return_index=True)[1], dtype=np.int_)


def _shown_frequencies(model: StageModel, sample_period_s: float | None,
                      measured_hz: FloatArray | None) -> FloatArray:
    """Return the frequencies of a Bode diagram of a model, including those of a measurement.

    Half the sample rate of the fast recording, if there is one, is the highest frequency.
    """
    low, high = drawn_frequencies(model)[[0, -1]]
    if measured_hz is not None and measured_hz.size:
        low, high = min(low, measured_hz.min()), max(high, min(measured_hz.max(), 10.0 * high))
    if sample_period_s is not None:
        high = max(min(high, 0.5 / sample_period_s), 2.0 * low)
    return np.geomspace(low, high, POINTS)
