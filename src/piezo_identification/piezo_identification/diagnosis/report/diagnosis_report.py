# SPDX-License-Identifier: BSD-3-Clause
"""The report of a diagnosis: one self-contained page for the logbook."""

from collections.abc import Iterator, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_common.report_page import Picture, Section, render_page
from piezo_identification.conditioning.sensor_sign import sign_text
from piezo_identification.diagnosis.comparison.attempts import Attempt
from piezo_identification.diagnosis.comparison.criteria import CRITERIA
from piezo_identification.diagnosis.comparison.selection import Selection
from piezo_identification.diagnosis.diagnose import Diagnosis
from piezo_identification.diagnosis.evidence.residual_tests import input_correlation, whiteness
from piezo_identification.diagnosis.report import diagnosis_pictures as pictures
from piezo_identification.diagnosis.report.distortion_section import distortion_sections
from piezo_identification.diagnosis.residual.noise_estimate import (
    residual_of_model_um,
    residual_um,
)
from piezo_identification.diagnosis.residual.simulated_recording import SimulatedRecording
from piezo_models.cascade import StageModel
from piezo_models.effects import known_effects


def verdict_sentence(diagnosis: Diagnosis) -> str:
    """Return the verdict in one sentence."""
    before, after = (1e3 * errors["rms_um"] for errors in (diagnosis.before, diagnosis.after))
    names = " and ".join(entry["name"] for entry in diagnosis.effects)
    if diagnosis.verdict == "none":
        anew = "" if after == before else (
            f", and {after:.3g} nm with its parameters estimated anew on all recordings")
        return f"The model lacks nothing that the data shows: {before:.3g} nm RMS are left{anew}."
    if diagnosis.verdict == "explained":
        if [entry["name"] for entry in diagnosis.effects] == ["outliers"]:
            # They are left out before and after; what changes is the model's own parameters.
            return (f"The sensor has outliers: without them {before:.3g} nm RMS are left on "
                    f"held-out data, and {after:.3g} nm with the model tuned to the other samples.")
        return (f"The model lacks {names}: with it the error on held-out data falls from "
                f"{before:.3g} to {after:.3g} nm RMS.")
    beside = f" beside {names}" if names else ""
    return (f"Something is left{beside} that no known effect explains: {after:.3g} nm RMS on "
            f"held-out data.")


def render_report(diagnosis: Diagnosis, origin: Sequence[tuple[str, str]] = ()) -> str:
    """Return the report as one HTML page.

    Parameters
    ----------
    diagnosis : Diagnosis
    origin : sequence of (str, str)
        What the page is to tell of when, and from which files: name and text.
    """
    noise, dataset = diagnosis.selection.regression.noise, diagnosis.selection.regression.dataset
    sections = [_found(diagnosis)]
    if diagnosis.effects:
        sections.append(Section("What was added", table=_effects(diagnosis.effects)))
    if diagnosis.left:
        sections.append(Section("What is left", (diagnosis.left,)))
    sections += [
        _recording(part, residual_um(dataset, index, noise=noise),
                   residual_of_model_um(dataset, index, diagnosis.model, noise),
                   noise.noise_um[index])
        for index, part in enumerate(dataset.simulated)]
    for index, part in enumerate(dataset.simulated):
        sections += distortion_sections(
            part, residual_um(dataset, index, noise=noise),
            residual_of_model_um(dataset, index, diagnosis.model, noise))
    if diagnosis.model is not dataset.model:
        sections.append(_other_parameters(dataset.model, diagnosis.model))
    sections += [*_tried(diagnosis.selection), _undecided(diagnosis)]
    return render_page(verdict_sentence(diagnosis),
                       [f"{name}: {text}" for name, text in origin], sections)


def _found(diagnosis: Diagnosis) -> Section:
    before, after = diagnosis.before, diagnosis.after
    where = "{samples} samples of {source}".format(**diagnosis.holdout)
    told = [f"Held out: {where}.", *(f"{text}." for text in diagnosis.left_out),
            *(f"{sign_text(path)}." for path in diagnosis.reversed)]
    rows = [
        ("error on held-out data", "before", "after"),
        ("RMS (nm)", *(f"{1e3 * errors['rms_um']:.4g}" for errors in (before, after))),
        ("e_y (%)", *(f"{errors['e_y_percent']:.4g}" for errors in (before, after))),
        ("noise of the sensor (nm)", f"{1e3 * diagnosis.noise_floor_um:.4g}", ""),
    ]
    if diagnosis.ceiling is not None:
        rows += [
            (f"{what} (nm)", "", f"{1e3 * diagnosis.ceiling[name]:.4g}") for what, name in (
                ("of what is left, predictable by a learner", "predictable_um"),
                ("the same from the voltage alone", "from_voltage_um"),
                ("random", "random_um"))]
    return Section("What was found", tuple(told), rows)


def _effects(effects: list[dict[str, Any]]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = [
        ("effect", "parameter", "value", "standard deviation", "error reduction (%)")]
    for entry in effects:
        first = True
        for name, value in entry["parameters"].items():
            deviation = entry.get("standard_deviations", {}).get(name)
            rows.append((
                entry["name"] if first else "", name, _number(value),
                "" if deviation is None else _number(deviation, 2),
                f"{entry['error_reduction_percent']:.1f}" if first else "",
            ))
            first = False
    return rows


def _recording(part: SimulatedRecording, before_um: FloatArray, after_um: FloatArray,
               noise_um: float) -> Section:
    def picture(name: str, caption: str, png: bytes) -> Picture:
        return Picture(name, caption, png, wide=True)

    return Section(str(part.path), table=_tests_table(part, before_um, after_um), pictures=(
        picture("Residuals", "Measured minus simulated displacement over time; right, close where "
                "the extension gains most.", pictures.draw_residuals(part, before_um, after_um)),
        picture("Spectra", "Spectra of the residuals, of the model and of the noise.",
                pictures.draw_spectra(part, before_um, after_um, noise_um)),
        picture("Error over frequency", "Part of the displacement by which the model is wrong, at "
                "the frequencies at which the residual follows it.",
                pictures.draw_error_response(part, before_um, after_um)),
        picture("Correlations", "Correlation of the residuals; the band holds 99 % of it where "
                "there is none.", pictures.draw_tests(part, before_um, after_um)),
        picture("Dependences", "Mean of the residuals where a quantity has some value; the bands "
                "hold 99 % of the means where nothing depends on it.",
                pictures.draw_dependences(part, before_um, after_um))))


def _tests_table(part: SimulatedRecording, before_um: FloatArray,
                 after_um: FloatArray) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = [("lags outside the band of 99 %", "before", "after")]
    before_um, after_um = before_um[part.begin :], after_um[part.begin :]
    voltage_v = part.voltage_v[part.begin :]
    for name, tests in (
        ("whiteness", [whiteness(residual) for residual in (before_um, after_um)]),
        ("correlation with the voltage",
         [input_correlation(residual, voltage_v) for residual in (before_um, after_um)]),
    ):
        rows.append((name, *(f"{100.0 * test.share_outside:.0f} %" for test in tests)))
    return rows


def _tried(selection: Selection) -> Iterator[Section]:
    yield Section("What was tried", (
        "Significance is in standard deviations of a gain by chance; more than "
        f"{CRITERIA.significant:g} are asked for. The tolerance is the noise and what a "
        "good model may be wrong by.",))
    for number, attempts in enumerate(selection.rounds, 1):
        rows: list[tuple[str, ...]] = [
            ("candidate", "error reduction (%)", "significance", "size / tolerance", "outcome")]
        rows += [
            (attempt.name, *(
                (f"{attempt.reduction_percent:.2f}", f"{attempt.significance:.1f}",
                 f"{attempt.size:.2f}") if attempt.fit is not None else ("-", "-", "-")),
             _outcome(attempt, attempts[0], selection)) for attempt in attempts
        ]
        yield Section(f"Round {number}, on held-out data; the best first", table=rows)


def _outcome(attempt: Attempt, best: Attempt, selection: Selection) -> str:
    """Tell in words what became of a candidate."""
    added = {effect.name for effect in selection.end.effects}
    if attempt.fit is None:
        among = "added already" if attempt.name in added else "nothing hints at it"
        return attempt.remark or among
    if attempt.name in added:
        return "added" if attempt is best else "added in the end"
    if attempt.name in selection.indistinguishable:
        return f"cannot be told from {selection.indistinguishable[attempt.name]}"
    if attempt.remark:
        return attempt.remark
    if attempt.reduction_percent <= 0.0:
        return "rejected: no gain"
    if attempt.significance <= CRITERIA.significant:
        return "rejected: not significant"
    return "rejected: too small" if attempt is best else f"rejected: less than {best.name}"


def _undecided(diagnosis: Diagnosis) -> Section:
    title = "What the data could not decide"
    if not diagnosis.not_decidable:
        return Section(title, ("Nothing.",))
    kinds = known_effects()
    rows: list[tuple[str, ...]] = [("effect", "why", "experiment that would")]
    rows += [
        (name, reason, kinds[name].experiment) for name, reason in diagnosis.not_decidable.items()
    ]
    return Section(title, table=rows)


def _other_parameters(before: StageModel, after: StageModel) -> Section:
    """Tabulate the model's own parameters; what they gain alone is no effect's."""
    rows: list[tuple[str, ...]] = [("parameter", "before", "after", "change (%)")]
    for old, new in ((before.dynamics, after.dynamics), (before.creep, after.creep)):
        for field in fields(old):
            pairs = zip(np.atleast_1d(getattr(old, field.name)),
                        np.atleast_1d(getattr(new, field.name)), strict=True)
            rows += [(field.name, _number(was), _number(now), f"{100.0 * (now / was - 1.0):+.2f}")
                     for was, now in pairs if was]
    density = [model.hysteresis.density_um_per_v2.sum() for model in (before, after)]
    rows.append(("density of the hysteresis, sum", *map(_number, density),
                 f"{100.0 * (density[1] / density[0] - 1.0):+.2f}"))
    return Section("What changed beside", (
        "Without the effects the model's own parameters had been fitted to make up for them. "
        "Beside the effects they were free to move as far as they are uncertain.",), rows)


def _number(value: float | Sequence[float], digits: int = 5) -> str:
    if isinstance(value, (list, tuple)):
        return ", ".join(f"{number:.{min(digits, 4)}g}" for number in value)
    return f"{value:.{digits}g}"
