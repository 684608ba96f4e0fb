# SPDX-License-Identifier: BSD-3-Clause
"""The page of an identification: parameters, adequacy, and the fit of each component."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from piezo_common.report_page import Section, pictured, render_page
from piezo_identification.adequacy.component_adequacy import INADEQUATE
from piezo_identification.conditioning.row_alignment import rows_read_at_start
from piezo_identification.identification.given_data import Data
from piezo_identification.identification.notes import Detail
from piezo_identification.prediction import predict
from piezo_identification.prediction.prediction_errors import named_errors
from piezo_identification.report.component_evidence import ComponentEvidence, component_evidence
from piezo_identification.report.identification_pictures import (
    bode_picture,
    component_pictures,
    density_picture,
)
from piezo_identification.report.parameter_table import parameter_table
from piezo_identification.report.simulation_report import prediction_pictures
from piezo_models.identified_model import IdentifiedModel
from piezo_recorder.reading.recording import Recording

E_Y = ("e_y is the norm of the difference over the norm of the measured displacement without its "
       "mean, in percent (4.20): 100 % is a model without any prediction.")


def identification_page(identified: IdentifiedModel, given: Mapping[str, Data], model: Path,
                        read_at_samples: float = 0.0, details: Sequence[Detail] = ()) -> str:
    """Return the page of an identification as HTML.

    `given` are the data from `given_data`, including the validation if there is one.
    `read_at_samples` is that of the call of `identify`, and `details` are the notes of that call on
    how the model was found.
    """
    evidence = component_evidence(identified, given, read_at_samples)
    validation = [data for name, data in given.items() if name == "validation"]
    return render_page(identification_sentence(identified), list(_origin(identified, model)), [
        _parameters(identified),
        *_adequacy(identified),
        *_errors(identified, validation),
        *(Section(f"{each.name.capitalize()}: {each.residual.path}",
                  [f"{each.hum[0].upper()}{each.hum[1:]}."] if each.hum else (),
                  pictures=list(component_pictures(each))) for each in evidence),
        _whole(identified, evidence),
        *_choices(details),
    ])


def identification_sentence(identified: IdentifiedModel) -> str:
    """Return a sentence on the fit of the model, and whether the model is unfinished."""
    unfinished = f"; unfinished: {identified.unfinished}" if identified.unfinished else ""
    return _on_fit(identified) + unfinished


def _on_fit(identified: IdentifiedModel) -> str:
    poor = {name: part for name, part in identified.adequacy.items()
            if part["verdict"] == INADEQUATE}
    if not identified.adequacy:
        return "A model of the stage, whose fit was not tested"
    if not poor:
        return "The model fits all its recordings down to their noise"
    worst = max(poor.items(), key=lambda item: item[1]["error_percent"])
    return (f"The residual is larger than the noise of the recordings: "
            f"{worst[1]['error_percent']:.2g} % of the {worst[0]}"
            + (" at most" if len(poor) > 1 else ""))


def _origin(identified: IdentifiedModel, model: Path) -> Iterator[str]:
    yield f"model: `{model}`, identified {identified.created}"
    for recording in identified.recordings:
        yield f"recording: `{recording['path']}`, SHA-256 {recording['sha256'][:16]}"


def _parameters(identified: IdentifiedModel) -> Section:
    table = parameter_table(identified)
    texts = ["Voltages: {:g} to {:g} V. Between them the displacement behind the hysteresis "
             "changes by {:.4g} um.".format(
                 *identified.voltage_range_v, identified.model.hysteresis.travel_um)]
    if len(table) == 1:
        return Section("Parameters", [*texts, "No linear dynamics were identified: the model is of "
                                      "the hysteresis alone."])
    return Section("Parameters", [
        *texts, "Standard deviations follow from the sensitivities of the fit and its residual. "
        "The interval holds the parameter in 95 of 100 repeats, if the residual is white noise."],
        table)


def _adequacy(identified: IdentifiedModel) -> Iterator[Section]:
    if not identified.adequacy:
        return
    rows: list[tuple[str, ...]] = [
        ("component", "residual (nm)", "noise (nm)", "residual over noise", "e_y (%)", "verdict")]
    rows += [(name, f"{1e3 * part['residual_rms_um']:.3g}", f"{1e3 * part['noise_rms_um']:.3g}",
              f"{part['ratio']:.3g}", f"{part['error_percent']:.2g}", part["verdict"])
             for name, part in identified.adequacy.items()]
    texts = [f"{name} is inadequate: {part['left']}. To do: {part['advice']}."
             for name, part in identified.adequacy.items() if part["verdict"] == INADEQUATE]
    yield Section("Does each component fit its recording?", [
        "On the data that were fitted. The residual is the RMS of measured minus fitted "
        "displacement, of the mean period where the voltage repeats itself; the noise is that in "
        "the same samples. A component is adequate if noise alone explains the residual, or if "
        "the residual is below 0.002 % of the travel. " + E_Y, *texts], rows)


def _errors(identified: IdentifiedModel, validation: list[Data]) -> Iterator[Section]:
    rows = [(what, f"{value:.3g}") for what, value in named_errors(identified.errors)]
    recording = next((data for data in validation if isinstance(data, Recording)), None)
    if not rows and recording is None:
        return
    pictures = []
    texts = [E_Y]
    if recording is not None:
        texts.insert(0, f"Validation: `{recording.path}`, which no parameter was fitted to.")
        if not recording.gaps:
            read_at = identified.rows.get("validation", {}).get("read_at_samples", 0.0)
            pictures = list(prediction_pictures(
                predict(identified.model, rows_read_at_start(recording, read_at))))
    yield Section("Errors on data that was not fitted", texts,
                  [("error on unseen data", "e_y (%)"), *rows] if rows else (), pictures)


def _whole(identified: IdentifiedModel, evidence: list[ComponentEvidence]) -> Section:
    fast = next((each for each in evidence if each.component == "dynamics"), None)
    model = identified.model
    pictures = [density_picture(identified)]
    if not model.dynamics.is_static or model.creep.poles_rad_per_s:
        pictures.insert(0, bode_picture(identified, fast))
    return Section("The model", pictures=pictures)


def _choices(details: Sequence[Detail]) -> Iterator[Section]:
    if details:
        yield Section(
            "What was tried", [f"{text}." for text in details if text.plot is None],
            pictures=[pictured(
                text.partition(":")[0].capitalize(), text.plot(),
                "What was tried: the filled mark was chosen, crosses were refused.")
                for text in details if text.plot is not None])
