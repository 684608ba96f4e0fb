# SPDX-License-Identifier: BSD-3-Clause
"""The second half of the demo's report: what the model lacked, and what its extension is worth."""

from dataclasses import dataclass

from piezo_common.report_page import Section, pictured
from piezo_identification.prediction import predict
from piezo_models.effects import known_effects
from piezo_studies.demo import extension_pictures
from piezo_studies.demo.summary import model_error_rows, tracking_error_rows


@dataclass(frozen=True, eq=False)
class SecondHalf:
    """What came of the diagnosis.

    Attributes
    ----------
    sentence : str
        The verdict in words.
    verdict : dict
        The content of ``verdict.json``.
    model : piezo_models.cascade.StageModel
        Extended.
    runs : list of TrackedRun
        Tracked with it.
    """

    sentence: str
    verdict: dict
    model: object
    runs: list


def second_half_sections(summary, runs, model, validation, second_half):
    """Return the sections of the report.

    Parameters
    ----------
    summary : dict
        With ``diagnosis`` and ``tracking_after``.
    runs : list of TrackedRun
        Tracked with the model as it was.
    model : piezo_models.cascade.StageModel
        As it was.
    validation : Recording
        On which the model is judged.
    second_half : SecondHalf
    """
    return (_effects_section(second_half.sentence, second_half.verdict["effects"]),
            _model_section(summary, model, validation, second_half),
            _tracking_section(summary, runs, second_half))


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
        (f"{sentence} Nothing told the diagnosis what the stage carries: it had the model and one "
         "recording of the experiment `diagnostic`, in which every effect shows that it knows.",
         "The page `diagnosis/report.html` beside this one holds the residuals, what was tried and "
         "rejected, and what the data could not decide; `diagnosis/verdict.json` holds the "
         "numbers."),
        rows if len(rows) > 1 else ())


def _model_section(summary, model, validation, second_half):
    before, after = (predict(each, validation) for each in (model, second_half.model))
    sample_period_s = 1.0 / validation.sample_rate_hz
    return Section(
        "The model before and after",
        ("Errors on the validation recording, which neither the identification nor the diagnosis "
         "fitted.",),
        model_error_rows(summary),
        (pictured("Model error before and after",
                  extension_pictures.draw_model_errors(before, after, sample_period_s),
                  "Spectrum of measured minus simulated displacement on the validation recording, "
                  "and the sensor's noise."),
         pictured("Response before and after", extension_pictures.draw_responses(
                      model, second_half.model, sample_period_s),
                  "From the hysteresis' output to the displacement, without and with what was "
                  "added.")))


def _tracking_section(summary, runs, second_half):
    return Section(
        "Tracking before and after",
        ("The same sines, modes and rests, with the extended model in place of the first; e_rms "
         "by the sensor.",),
        tracking_error_rows(summary),
        (pictured("Tracking errors before and after",
                  extension_pictures.draw_tracking_errors(
                      _composite(runs), _composite(second_half.runs)),
                  "Error of composite over the last periods, by the sensor.", tall=True),))


def _composite(runs):
    return {run.frequency_hz: run for run in runs if run.mode == "composite"}


def _number(value):
    if isinstance(value, list):
        return ", ".join(f"{number:.4g}" for number in value)
    return f"{value:.5g}"
