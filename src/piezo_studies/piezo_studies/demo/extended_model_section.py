# SPDX-License-Identifier: BSD-3-Clause
"""The part of the demo's report on the extended model: the missing effects and the improvement."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import welch

from piezo_common.picture_style import AFTER, BEFORE, LIMIT, label, new_figure, plain_numbers
from piezo_common.report_page import Section, pictured
from piezo_identification.prediction import predict
from piezo_models.effects import known_effects
from piezo_models.linear.dynamics import zoh_response
from piezo_models.model_file import load_model
from piezo_recorder.reading.reader import read_recording
from piezo_studies.demo.summary import model_error_rows, tracking_error_rows

RESPONSE_HZ = np.geomspace(50.0, 4000.0, 1500)
SEGMENT = 8192
SHOWN_PERIODS = 2
QUIET_HZ = 8000.0
"""Frequency above which the stage does not move, so that the signal is sensor noise."""


def _compared(before, after):
    """Draw two curves, each of frequencies and values, on new double-logarithmic axes."""
    figure = new_figure()
    axes = figure.subplots()
    for curve, style in ((before, BEFORE), (after, AFTER)):
        axes.loglog(*curve, **style)
    return figure, axes


def draw_model_errors(before, after, sample_period_s):
    """Draw the spectra of a model's error on one recording, before and after."""
    def density(prediction):
        frequency_hz, power = welch(
            1e3 * (prediction.measured_um - prediction.simulated_um), 1.0 / sample_period_s,
            nperseg=min(SEGMENT, prediction.measured_um.size))
        return frequency_hz[1:-1], np.sqrt(power[1:-1])

    curves = density(before), density(after)
    figure, axes = _compared(*curves)
    frequency_hz, residual = curves[1]
    axes.axhline(np.median(residual[frequency_hz > QUIET_HZ]), label="noise", **LIMIT)
    axes.legend()
    label(axes, "frequency (Hz)", "model error (nm per root Hz)")
    return figure


def draw_responses(before, after, sample_period_s):
    """Draw the magnitude of the sampled linear part of two models."""
    figure, axes = _compared(*(
        (RESPONSE_HZ, np.abs(zoh_response(model.linear(), RESPONSE_HZ, sample_period_s)))
        for model in (before, after)))
    axes.legend()
    plain_numbers(axes.xaxis)
    label(axes, "frequency (Hz)", "magnitude (um/um)")
    return figure


def draw_tracking_errors(before, after):
    """Draw the errors of runs, by frequency in Hz, over their last periods, each in a row."""
    figure = new_figure(1.2 + 1.5 * len(after))
    rows = figure.subplots(len(after), 1, squeeze=False)[:, 0]
    for axes, frequency_hz in zip(rows, sorted(after), strict=True):
        for runs, style in ((before, BEFORE), (after, AFTER)):
            run = runs[frequency_hz]
            count = round(SHOWN_PERIODS * run.sample_rate_hz / frequency_hz)
            time_ms = 1e3 * np.arange(count) / run.sample_rate_hz
            axes.plot(time_ms, 1e3 * run.error_um[-count:], **style)
        label(axes, "time (ms)", "error (nm)",
              title=f"{frequency_hz:g} Hz, {run.amplitude_um:g} um peak to peak")
    figure.legend(*rows[0].get_legend_handles_labels(), loc="outside upper center", ncols=2,
                  frameon=False)
    figure.align_ylabels()
    return figure


@dataclass(frozen=True, eq=False)
class ExtendedModel:
    """The result of the diagnosis, and the runs with the extended model."""

    sentence: str
    """The verdict in words."""
    verdict: dict
    """The content of ``verdict.json``."""
    pictures: tuple
    """Figures from `draw_models`."""
    runs: list


def draw_models(model, extended_model, validation):
    """Draw errors on a recording, and responses, of a model before and after its extension."""
    return drawn_models(load_model(model).model, load_model(extended_model).model,
                        read_recording(validation))


def drawn_models(model, extended_model, validation):
    """Draw models and a recording already read; see `draw_models`."""
    before, after = (predict(each, validation) for each in (model, extended_model))
    sample_period_s = 1.0 / validation.sample_rate_hz
    return (
        pictured("Model error before and after",
                 draw_model_errors(before, after, sample_period_s),
                 "Spectrum of measured minus simulated displacement on the validation recording, "
                 "and the sensor's noise.", closer=True),
        pictured("Response before and after", draw_responses(
                     model, extended_model, sample_period_s),
                 "From the hysteresis' output to the displacement, without and with what was "
                 "added.", closer=True))


def extended_model_sections(summary, runs, extended):
    """Return the sections of the report, from the keys ``diagnosis`` and ``tracking_after``."""
    return (_effects_section(extended.sentence, extended.verdict["effects"]),
            _model_section(summary, extended),
            _tracking_section(summary, runs, extended))


def _effects_section(sentence, effects):
    units = {name: kind.units() for name, kind in known_effects().items()}
    rows = [["effect", "parameter", "value", "standard deviation"]]
    for entry in effects:
        for name, value in entry["parameters"].items():
            deviation = entry.get("standard_deviations", {}).get(name)
            unit = units[entry["name"]][name]
            label = name if unit == "1" else f"{name} ({unit})"
            rows.append([entry["name"], label, _number(value),
                         "-" if deviation is None else _number(deviation)])
    return Section(
        "What the model lacks",
        (f"{sentence} The diagnosis had only the model and one recording of the experiment "
         "`diagnostic`, which excites every effect in the list of the diagnosis.",
         "The page `diagnosis/report.html` next to this one holds the residuals, what was tried "
         "and rejected, and what the data could not decide; `diagnosis/verdict.json` holds the "
         "numbers."),
        rows if len(rows) > 1 else ())


def _model_section(summary, extended):
    return Section(
        "The model before and after",
        ("Errors on the validation recording, which neither the identification nor the diagnosis "
         "fitted.",),
        model_error_rows(summary), extended.pictures)


def _tracking_section(summary, runs, extended):
    return Section(
        "Tracking before and after",
        ("The same sines, modes and rests, with the extended model in place of the first; e_rms "
         "by the sensor.",),
        tracking_error_rows(summary),
        (pictured("Tracking errors before and after",
                  draw_tracking_errors(
                      _composite(runs), _composite(extended.runs)),
                  "Error of composite over the last periods, by the sensor.", tall=True,
                  closer=True),))


def _composite(runs):
    return {run.frequency_hz: run for run in runs if run.mode == "composite"}


def _number(value):
    if isinstance(value, list):
        return ", ".join(f"{number:.4g}" for number in value)
    return f"{value:.5g}"
