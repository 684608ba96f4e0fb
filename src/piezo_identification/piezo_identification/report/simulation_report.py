# SPDX-License-Identifier: BSD-3-Clause
"""The page of a simulation: simulated compared with measured displacement."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from matplotlib.figure import Figure

from piezo_common.arrays import FloatArray
from piezo_common.picture_style import WIDE_IN, new_figure
from piezo_common.report_page import Picture, Section, pictured, render_page
from piezo_identification.conditioning.sensor_noise import repeated_period, sensor_noise_um
from piezo_identification.conditioning.waveforms import slow_branches
from piezo_identification.prediction.prediction import Prediction
from piezo_identification.report import signal_pictures as signals
from piezo_identification.report.waveform_view import WaveformView, view_of


def simulation_page(prediction: Prediction, origin: Sequence[str], texts: Sequence[str],
                    deviation_um: FloatArray | None = None) -> str:
    """Return the page of a simulation as HTML.

    `origin` names the files of model and recording; `texts` are remarks on the start, on outliers,
    and on motion outside the identified range.
    """
    noise_um = noise_of(prediction)
    residual_um = residual_of(prediction)[prediction.good]
    residual_um = residual_um - residual_um.mean()
    rows = [
        ("error", "value"),
        ("e_y (%)", f"{prediction.e_y_percent():.3g}"),
        ("RMS of the residual (nm)", f"{1e3 * np.sqrt(np.mean(residual_um**2)):.3g}"),
        ("largest (nm)", f"{1e3 * np.abs(residual_um).max():.3g}"),
        ("noise of the sensor (nm)", f"{1e3 * noise_um:.3g}"),
        ("travel (um)", f"{np.ptp(prediction.measured_um[prediction.good]):.4g}"),
    ]
    return render_page(
        f"The model is off by {prediction.e_y_percent():.2g} % on this recording", origin, [
            Section("Errors", [
                "e_y is the norm of the difference over the norm of the measured displacement "
                "without its mean (4.20). Offset, initial creep and, as far as the recording does "
                "not show it, the past of the hysteresis are fitted. The noise is the lowest "
                "estimate from rests, repeats and the highest frequencies.", *texts], rows),
            Section("Measured and simulated", pictures=list(
                prediction_pictures(prediction, deviation_um)))])


def noise_of(prediction: Prediction) -> float:
    """Return the standard deviation of the sensor's noise in a prediction."""
    return sensor_noise_um(
        prediction.measured_um, prediction.voltage_v,
        residual_of(prediction), repeated_period(prediction.voltage_v))


def residual_of(prediction: Prediction) -> FloatArray:
    """Return measured minus simulated displacement, 0 at outliers, shape (N,)."""
    return np.where(prediction.good, prediction.measured_um - prediction.simulated_um, 0.0)


def displacement_figure(prediction: Prediction, deviation_um: FloatArray | None = None,
                        noise_um: float | None = None) -> Figure:
    """Draw measured and simulated displacement and the residual, by the kind of waveform.

    The standard deviation of the simulation, (N,), is drawn as a band of twice its size.
    """
    view = view_of(prediction.voltage_v, _sample_period_s(prediction))
    figure = signals.time_figure(
        new_figure(5.0, WIDE_IN), view, prediction.measured_um, prediction.simulated_um,
        residual_of(prediction), noise_um, deviation_um)
    figure.axes[0].set_title(
        f"{view.title}, e_y = {prediction.e_y_percent():.3g} %", fontsize="medium")
    return figure


def loops_figure(prediction: Prediction) -> Figure:
    """Draw measured and simulated displacement over the voltage, averaged over periods if any."""
    view = view_of(prediction.voltage_v, _sample_period_s(prediction))
    figure = new_figure(5.0, WIDE_IN)
    axes = figure.subplots()
    voltage_v, measured_um, simulated_um = (view.mean(values) for values in (
        prediction.voltage_v, prediction.measured_um, prediction.simulated_um))
    signals.draw_loops(axes, voltage_v, measured_um, simulated_um)
    axes.set_title(view.title, fontsize="medium")
    return figure


def prediction_pictures(prediction: Prediction,
                        deviation_um: FloatArray | None = None) -> Iterator[Picture]:
    """Yield figures that suit the kind of waveform.

    These are the displacement over time, or its mean period if the voltage is periodic; the loops
    of slow branches; the gain of a broadband voltage; the residual over time and frequency.
    """
    view = view_of(prediction.voltage_v, _sample_period_s(prediction))
    noise_um, residual_um = noise_of(prediction), residual_of(prediction)
    yield pictured("Displacement", displacement_figure(prediction, deviation_um, noise_um),
                   f"Measured and simulated displacement, {view.title}; below, the residual; "
                   "dotted, twice the noise.", wide=True, closer=True)
    yield from _residual_pictures(prediction, view, residual_um, noise_um)
    if view.is_mean:
        yield signals.picture_over_time(
            "Residual over time", view, residual_um, noise_um, deviation_um)
    yield signals.picture_over_frequency(
        "Residual over frequency", residual_um, prediction.measured_um, view.sample_period_s,
        noise_um, "the sensor's")


def _residual_pictures(prediction: Prediction, view: WaveformView, residual_um: FloatArray,
                       noise_um: float) -> Iterator[Picture]:
    """Yield slow loops and gain of a waveform without levels."""
    if view.has_levels:
        return
    slow = slow_branches(prediction.time_s, prediction.voltage_v)
    drawn = prediction.voltage_v, prediction.measured_um, prediction.simulated_um, residual_um
    if view.is_mean and not view.kind.is_broadband:
        yield _loops(map(view.mean, drawn), noise_um / np.sqrt(view.periods), view.title)
    elif slow.any():
        title = "its slow branches" if not slow.all() else view.title
        yield _loops((values[slow] for values in drawn), noise_um, title)
    if view.kind.is_broadband:
        figure = new_figure(4.0)
        signals.draw_gain(figure.subplots(), prediction.voltage_v, prediction.measured_um,
                          view.sample_period_s, prediction.simulated_um)
        yield pictured("Gain", figure, "Gain from voltage to displacement, of the measurement and "
                       "of the model under the same voltage.", closer=True)


def _loops(drawn: Iterable[FloatArray], noise_um: float, title: str) -> Picture:
    voltage_v, measured_um, simulated_um, residual_um = drawn
    figure = signals.loops_figure(
        4.8, voltage_v, measured_um, simulated_um, residual_um, noise_um)
    return pictured("Loops", figure, f"Displacement over voltage, measured and simulated: {title}; "
                    "below, the residual; dotted, twice the noise.", closer=True)


def _sample_period_s(prediction: Prediction) -> float:
    return float(np.median(np.diff(prediction.time_s[:1000])))
