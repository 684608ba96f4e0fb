# SPDX-License-Identifier: BSD-3-Clause
"""The part of the demo's report on the extended model: the missing effects and the improvement."""

from dataclasses import dataclass

from piezo_common.report_page import Section, pictured
from piezo_identification.prediction import predict
from piezo_models.effects import known_effects
from piezo_models.model_file import load_model
from piezo_recorder.reading.reader import read_recording
from piezo_studies.demo import extension_pictures
from piezo_studies.demo.summary import model_error_rows, tracking_error_rows


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
    """Runs with the extended model."""


def draw_models(model, extended_model, validation):
    """Draw errors and responses of a model before and after its extension.

    Parameters
    ----------
    validation : path-like
        Recording on which they are compared.
    """
    return drawn_models(load_model(model).model, load_model(extended_model).model,
                        read_recording(validation))


def drawn_models(model, extended_model, validation):
    """Draw models and a recording already read; see `draw_models`."""
    before, after = (predict(each, validation) for each in (model, extended_model))
    sample_period_s = 1.0 / validation.sample_rate_hz
    return (
        pictured("Model error before and after",
                 extension_pictures.draw_model_errors(before, after, sample_period_s),
                 "Spectrum of measured minus simulated displacement on the validation recording, "
                 "and the sensor's noise.", closer=True),
        pictured("Response before and after", extension_pictures.draw_responses(
                     model, extended_model, sample_period_s),
                 "From the hysteresis' output to the displacement, without and with what was "
                 "added.", closer=True))


def extended_model_sections(summary, runs, extended):
    """Return the sections of the report.

    Parameters
    ----------
    summary : dict
        Summary with the keys ``diagnosis`` and ``tracking_after``.
    extended : ExtendedModel
    """
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
                  extension_pictures.draw_tracking_errors(
                      _composite(runs), _composite(extended.runs)),
                  "Error of composite over the last periods, by the sensor.", tall=True,
                  closer=True),))


def _composite(runs):
    return {run.frequency_hz: run for run in runs if run.mode == "composite"}


def _number(value):
    if isinstance(value, list):
        return ", ".join(f"{number:.4g}" for number in value)
    return f"{value:.5g}"
