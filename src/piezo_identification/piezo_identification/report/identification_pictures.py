# SPDX-License-Identifier: BSD-3-Clause
"""Figures that compare an identified model with the recordings it was estimated from."""

from collections.abc import Iterator

import numpy as np
from matplotlib.figure import Figure

from piezo_common.picture_style import (
    BLACK,
    MEASURED,
    MODELLED,
    label,
    new_figure,
    plain_numbers,
)
from piezo_common.report_page import Picture, pictured
from piezo_identification.report import signal_pictures as signals
from piezo_identification.report.component_evidence import ComponentEvidence
from piezo_identification.report.measured_response import measured_response, shown_frequencies
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_pictures import density_on
from piezo_models.model_summary import visited_fraction
from piezo_models.response_band import draw_bode

FIT_HEIGHT_IN = 6.4
"""Height of the figure of a fit, equal to that of the two figures next to it."""


def component_pictures(evidence: ComponentEvidence) -> Iterator[Picture]:
    """Yield the fit of a component with its recording, and its residual over time and frequency."""
    name = evidence.name
    yield fit_picture(evidence)
    if evidence.is_response:
        return
    yield pictured(f"Residual of the {name} over time", _over_time(evidence),
                   "Measured minus fitted displacement of all samples; dotted, twice the noise, "
                   "between which 95 % of it lies.", closer=True)
    yield pictured(f"Residual of the {name} over frequency", _over_frequency(evidence),
                   "Density of the residual, and of the measured displacement; dotted, white noise "
                   f"as large as that estimated from {evidence.fit.noise_from}.", closer=True)


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
    figure = new_figure(FIT_HEIGHT_IN)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    if evidence.component == "creep" and residual.steps.size:
        signals.draw_creep(above, below, residual.steps, residual.voltage_v, residual.measured_um,
                           evidence.fitted_um, residual.sample_period_s)
        return figure, ("Mean creep after the steps, measured and modelled; below, the residual "
                        "without its mean.")
    if evidence.component == "hysteresis" and not view.has_levels and (
            not view.kind.is_broadband):
        signals.draw_loops(above, residual.voltage_v, residual.measured_um, evidence.fitted_um)
        signals.draw_loop_difference(below, residual.voltage_v, evidence.residual_um,
                                     evidence.noise_um)
        above.set_xlabel("")
        return figure, "Loops, measured and modelled; below, the residual, and twice the noise."
    signals.draw_measured(above, view, residual.measured_um, evidence.fitted_um)
    signals.draw_difference(below, view, evidence.residual_um, evidence.noise_um)
    above.set_xlabel("")
    of_mean = ", and twice the noise in a mean of so many periods" if view.is_mean else ""
    return figure, f"Measured and modelled, {view.title}; below, the residual{of_mean}."


def _over_time(evidence: ComponentEvidence) -> Figure:
    figure = new_figure(3.0)
    axes = figure.subplots()
    whole = evidence.view.whole(evidence.residual.time_s.size)
    signals.draw_difference(axes, whole, evidence.residual_um, evidence.noise_um)
    return figure


def _over_frequency(evidence: ComponentEvidence) -> Figure:
    figure = new_figure(3.6)
    signals.draw_residual_spectrum(
        figure.subplots(), evidence.residual_um, evidence.residual.measured_um,
        evidence.residual.sample_period_s, evidence.noise_um)
    return figure


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
    measured = None if evidence is None else measured_response(
        identified.model, evidence.residual, evidence.fit)
    period_s = None if evidence is None or evidence.is_response else (
        evidence.residual.sample_period_s)
    measured_hz = None if measured is None else measured[0]
    frequency_hz = shown_frequencies(identified.model, period_s, measured_hz)
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
