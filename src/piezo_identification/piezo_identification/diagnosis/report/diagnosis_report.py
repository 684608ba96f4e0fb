# SPDX-License-Identifier: BSD-3-Clause
"""The report of a diagnosis: one self-contained page for the logbook."""

from collections.abc import Iterator, Sequence
from dataclasses import fields

import numpy as np
from matplotlib.figure import Figure

from piezo_common.arrays import FloatArray
from piezo_common.report_page import Picture, Section, pictured, render_page
from piezo_identification.analysis.distortion_over_frequency import distortion_png, distortion_rows
from piezo_identification.analysis.nonlinear_distortion import error_distortion
from piezo_identification.diagnosis.comparison.criteria import CRITERIA
from piezo_identification.diagnosis.comparison.selection import Attempt, Selection
from piezo_identification.diagnosis.diagnose import Diagnosis
from piezo_identification.diagnosis.evidence.effect_entries import (
    LEAST_PROBABILITY,
    STAND_IN,
    name_of,
)
from piezo_identification.diagnosis.evidence.residual_tests import input_correlation, whiteness
from piezo_identification.diagnosis.joint.probabilities import LISTED, SOMETHING_ELSE
from piezo_identification.diagnosis.report import diagnosis_pictures as pictures
from piezo_identification.report.parameter_table import effect_rows
from piezo_identification.simulation.simulated_recording import SimulatedRecording
from piezo_models.cascade import StageModel
from piezo_models.effects import known_effects

UNLIKELY = 0.5
"""Probability of deciding below which a recording will more likely decide nothing."""


def verdict_sentence(diagnosis: Diagnosis) -> str:
    """Return the verdict in one sentence, with its probability if it is known."""
    probability = "" if diagnosis.not_tried else _probability(diagnosis)
    return f"{_sentence(diagnosis)}{probability}"


def _sentence(diagnosis: Diagnosis) -> str:
    before, after = (1e3 * errors["rms_um"] for errors in (diagnosis.before, diagnosis.after))
    names = " and ".join(map(name_of, diagnosis.effects))
    if diagnosis.verdict == "none":
        after_refit = "" if after == before else (
            f", and {after:.3g} nm with its parameters estimated again")
        return f"The data shows no missing effect: {before:.3g} nm RMS remain{after_refit}."
    if diagnosis.verdict == "explained":
        if [entry["name"] for entry in diagnosis.effects] == ["outliers"]:
            # Outliers are excluded before and after; the model's own parameters differ.
            return (f"The sensor has outliers: without them {before:.3g} nm RMS remain on "
                    f"held-out data, and {after:.3g} nm with the model tuned to the other samples.")
        return (f"The model lacks {names}: with it the error on held-out data falls from "
                f"{before:.3g} to {after:.3g} nm RMS.")
    residual = f"With {names} a residual" if names else "A residual"
    compared = "effect compared until then" if diagnosis.not_tried else "known effect"
    return (f"{residual} remains that no {compared} explains: {after:.3g} nm RMS on "
            f"held-out data.")


def _probability(diagnosis: Diagnosis) -> str:
    """Return the sentence on the probability of the verdict; empty if it is not known."""
    names = {entry["name"] for entry in diagnosis.effects}
    own = {"none": {"none"}, "unexplained": {SOMETHING_ELSE}}.get(diagnosis.verdict, names)
    found = next((value for name, value in diagnosis.probabilities.items()
                  if set(name.split("+")) == own), None)
    return "" if found is None else f" The probability of this is {_percent(found)} %."


def _percent(probability: float) -> str:
    """Return a probability in percent, but never rounded to 0 or 100."""
    percent = 100.0 * probability
    if percent > 99.9:
        return "more than 99.9"
    return "less than 0.1" if percent < 0.1 else f"{percent:.3g}"


def render_report(diagnosis: Diagnosis, origin: Sequence[tuple[str, str]] = ()) -> str:
    """Return the report as one HTML page, with time and files as pairs of name and text."""
    dataset = diagnosis.selection.regression.dataset
    sections = [_found(diagnosis), *_alternatives(diagnosis)]
    if diagnosis.effects:
        sections.append(Section(
            "What was added", tuple(_on_intervals(diagnosis)), effect_rows(diagnosis.effects)))
    sections += _residual(diagnosis)
    sections += [_undecided(diagnosis), *_would_decide(diagnosis)]
    residuals = [pictures.residuals_um(diagnosis, index) for index in range(len(dataset.simulated))]
    sections += [_recording(diagnosis, each) for each in residuals]
    for each in residuals:
        sections += distortion_sections(each.part, each.before_um, each.after_um)
    if diagnosis.model is not dataset.model:
        sections.append(_other_parameters(dataset.model, diagnosis.model))
    sections += _tried(diagnosis.selection)
    return render_page(verdict_sentence(diagnosis),
                       [f"{name}: {text}" for name, text in origin], sections)


def _on_intervals(diagnosis: Diagnosis) -> Iterator[str]:
    if any("standard_deviations" in entry for entry in diagnosis.effects):
        yield ("Standard deviations are those of the joint fit of all effects; the interval holds "
               "the parameter in 95 of 100 repeats.")
    stand_ins = [entry["name"] for entry in diagnosis.effects if entry.get(STAND_IN)]
    if stand_ins:
        yield (f"What the model lacks behaves like {' and '.join(stand_ins)}, which fits but "
               "cannot be believed: a parameter ended at its bound, the probability is below "
               f"{LEAST_PROBABILITY:g}, or it contributes less than the noise next to a stronger "
               "effect. So there is no interval.")


def _found(diagnosis: Diagnosis) -> Section:
    before, after = diagnosis.before, diagnosis.after
    where = "{samples} samples of {source}".format(**diagnosis.holdout)
    texts = [f"Held out: {where}, the same before and after. e_y is the norm of the difference "
             "over that of the measured displacement without its mean, in percent (4.20).",
             *(f"It ended early: {each}." for each in filter(None, [diagnosis.not_tried])),
             *(f"{text}." for text in diagnosis.left_out),
             *(f"{fault['name']}: {fault['sentence']}. What to do: {fault['remedy']}."
               for fault in diagnosis.recording_faults)]
    rows = [
        ("error on held-out data", "before", "after"),
        ("RMS (nm)", *(f"{1e3 * errors['rms_um']:.3g}" for errors in (before, after))),
        ("e_y (%)", *(f"{errors['e_y_percent']:.3g}" for errors in (before, after))),
        ("noise of the sensor (nm)", *2 * (f"{1e3 * diagnosis.noise_floor_um:.3g}",)),
    ]
    return Section("What was found", tuple(texts), rows)


def _alternatives(diagnosis: Diagnosis) -> Iterator[Section]:
    known = diagnosis.probabilities
    if not known:
        return
    shown = [(name, value) for name, value in sorted(
        known.items(), key=lambda item: -item[1]) if value >= LISTED]
    rest = len(known) - len(shown)
    texts = ["Each row is a whole model with these effects in it; the probabilities sum to one."]
    if rest:
        texts.append(f"{rest} more {'has' if rest == 1 else 'have'} less than "
                     f"{100.0 * LISTED:g} %.")
    yield Section("Alternatives", texts, [("what the model lacks", "probability (%)"), *(
        (_alternative(name), _percent(value)) for name, value in shown)])


def _alternative(name: str) -> str:
    if name == SOMETHING_ELSE:
        return "something else than the known effects"
    return "nothing" if name == "none" else " and ".join(name.split("+"))


def _residual(diagnosis: Diagnosis) -> Iterator[Section]:
    """Yield the section on the residual, and the part of it that any learner would predict."""
    texts, rows = [diagnosis.left] if diagnosis.left else [], []
    if diagnosis.ceiling is not None:
        ceiling = {name: 1e3 * value for name, value in diagnosis.ceiling.items()}
        texts.append(
            "The ceiling: a learner that knows nothing of stages predicts the residual from "
            "voltage, displacement and their past, on data held out. What it predicts is "
            "deterministic and has no name yet; the rest is random.")
        rows = [("part of the residual", "RMS (nm)"), *(
            (what, f"{ceiling[name]:.3g}") for what, name in (
                ("predictable by a learner", "predictable_um"),
                ("predictable from the voltage alone", "from_voltage_um"),
                ("random", "random_um")))]
    if texts:
        yield Section("Residual", texts, rows)


def _recording(diagnosis: Diagnosis, residuals: pictures.Residuals) -> Section:
    def picture(name: str, caption: str, figure: Figure) -> Picture:
        return pictured(name, figure, caption, wide=True, closer=True)

    return Section(
        str(residuals.part.path), _on_whiteness(diagnosis, residuals), _tests_table(residuals), (
            picture("Residuals", "Measured minus simulated displacement over time; right, close "
                    "where the extension gains most. Dotted, twice the sensor's noise.",
                    pictures.draw_residuals(residuals)),
            picture("Residuals over voltage", "Measured minus simulated displacement over the "
                    "voltage; dotted, twice the sensor's noise.",
                    pictures.draw_over_voltage(residuals)),
            picture("Spectra", "Spectra of the residuals, of the model's displacement and of the "
                    "sensor's noise.", pictures.draw_spectra(residuals)),
            picture("Error over frequency", "Part of the displacement by which the model is wrong, "
                    "at the frequencies at which the residual follows it and the displacement "
                    "stands out of the noise.",
                    pictures.draw_error_response(residuals)),
            picture("Correlations", "Correlation of the residuals; the band holds 99 % of it where "
                    "there is none.", pictures.draw_tests(residuals)),
            picture("Dependences", "Mean of the residuals where a quantity has some value; the "
                    "bands hold 99 % of the means where nothing depends on it.",
                    pictures.draw_dependences(residuals))))


def _on_whiteness(diagnosis: Diagnosis, residuals: pictures.Residuals) -> list[str]:
    """Explain a residual that is not white in spite of a successful verdict."""
    _, after_um = residuals.both_um
    test = whiteness(after_um)
    texts = ["Of white noise about 1 % of the lags lie outside the band of 99 %."]
    if diagnosis.verdict == "unexplained" or test.passed:
        return texts
    extended = "after the extension " if diagnosis.effects else ""
    return [*texts, (
        f"That {100.0 * test.share_outside:.0f} % do {extended}is no contradiction to "
        f"the verdict. The test asks whether the residual is noise alone, not how large it is: of "
        f"{after_um.size} samples it sees a correlation of {test.band:.2g}. The residual is "
        f"{1e3 * np.std(after_um):.3g} nm at a noise of {1e3 * residuals.noise_um:.3g} nm, within "
        "the error that a model identified on noisy data may have.")]


def _tests_table(residuals: pictures.Residuals) -> list[tuple[str, ...]]:
    of_itself = [whiteness(residual_um) for residual_um in residuals.both_um]
    with_voltage = [input_correlation(residual_um, residuals.voltage_v)
                    for residual_um in residuals.both_um]
    return [("lags outside the band of 99 %", "before", "after"), *(
        (name, *(f"{100.0 * test.share_outside:.0f} %" for test in tests))
        for name, tests in (("whiteness", of_itself),
                            ("correlation with the voltage", with_voltage)))]


def _tried(selection: Selection) -> Iterator[Section]:
    yield Section("What was tried", (
        "Significance is in standard deviations of a gain by chance; more than "
        f"{CRITERIA.significant:g} are required. The tolerance is the noise and the "
        "error that a good model may have.",))
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
    """Return the outcome of a candidate in words."""
    added = {effect.name for effect in selection.end.effects}
    if attempt.fit is None:
        among = "added already" if attempt.name in added else "no initial guess was found"
        return attempt.undecided.sentence if attempt.undecided else among
    if attempt.name in added:
        return "added" if attempt is best else "added in the end"
    if attempt.name in selection.indistinguishable:
        return f"cannot be distinguished from {selection.indistinguishable[attempt.name]}"
    if attempt.undecided:
        return attempt.undecided.sentence
    if attempt.reduction_percent <= 0.0:
        return "rejected: no gain"
    if attempt.significance <= CRITERIA.significant:
        return "rejected: not significant"
    return "rejected: too small" if attempt is best else f"rejected: less than {best.name}"


def _undecided(diagnosis: Diagnosis) -> Section:
    title = "What the data could not decide, and what would"
    if not diagnosis.not_decidable:
        return Section(title, ("Nothing.",))
    kinds = known_effects()
    rows: list[tuple[str, ...]] = [("effect", "why", "experiment that would")]
    rows += [
        (name, reason, kinds[name].experiment) for name, reason in diagnosis.not_decidable.items()
    ]
    return Section(title, table=rows)


def _would_decide(diagnosis: Diagnosis) -> Iterator[Section]:
    """Yield the recording that would decide between the alternatives, and their predictions."""
    designed = diagnosis.next_experiment
    if designed is None:
        return
    chance = designed["probability_of_deciding"]
    texts = [f"Play {designed['file']}: {designed['description']}, from {designed['lowest_v']:.3g} "
             f"to {designed['highest_v']:.3g} V, for {designed['duration_s']:.3g} s. Then diagnose "
             "both recordings together. The probability that one explanation has more than 95 % "
             f"afterwards is {_percent(chance)} %."]
    if chance < UNLIKELY:
        texts.append("No waveform of the families that were tried decides more surely: "
                     "within these limits the stage does not show which one is right.")
    rows: list[tuple[str, ...]] = [(
        "if it lacks", "probability (%)", "probability that this is decided (%)",
        "RMS difference from the others (nm)")]
    rows += [(_alternative(each["effects"]), _percent(each["probability"]),
              _percent(each["probability_of_deciding"]),
              ", ".join(f"{_alternative(name)}: {1e3 * apart_um:.3g}" for name, apart_um in
                        each["expected_rms_difference_um"].items()))
             for each in designed["alternatives"]]
    yield Section("What would decide", texts, rows)


def _other_parameters(before: StageModel, after: StageModel) -> Section:
    """Tabulate the changes of the model's own parameters."""
    rows: list[tuple[str, ...]] = [("parameter", "before", "after", "change (%)")]
    for old, new in ((before.dynamics, after.dynamics), (before.creep, after.creep)):
        for field in fields(old):
            pairs = zip(np.atleast_1d(getattr(old, field.name)),
                        np.atleast_1d(getattr(new, field.name)), strict=True)
            rows += [(field.name, f"{was:.5g}", f"{now:.5g}", f"{100.0 * (now / was - 1.0):+.2f}")
                     for was, now in pairs if was]
    density = [model.hysteresis.density_um_per_v2.sum() for model in (before, after)]
    if density[0]:
        rows.append(("density of the hysteresis, sum", *(f"{each:.5g}" for each in density),
                     f"{100.0 * (density[1] / density[0] - 1.0):+.2f}"))
    return Section("Changes of the model's own parameters", (
        "Without the effects the model's own parameters had been fitted to make up for them. "
        "With the effects they were free to change within their uncertainty.",), rows)


def distortion_sections(part: SimulatedRecording, before_um: FloatArray,
                        after_um: FloatArray) -> list[Section]:
    """Return the section on distortion from residuals, (N,); empty for other voltages."""
    before, after = (error_distortion(part, residual) for residual in (before_um, after_um))
    if before is None or after is None:
        return []
    answer = before.answer
    rows: list[tuple[str, ...]] = [
        ("part of the answer (%)", "stage", "error before", "error after")]
    for name, value in (("linear", "linear_um"), ("even distortion", "even_um"),
                        ("odd distortion", "odd_um"), ("noise of a period", "noise_of_period_um"),
                        ("significant above", "significant_um")):
        rows.append((name, *(f"{100.0 * getattr(found, value) / answer.answer_um:.3g}"
                             for found in (answer, before.error, after.error))))
    pictures = [
        Picture(name, caption, distortion_png(found), wide=True) for name, caption, found in (
            ("Distortion of the stage", "Answer, noise, even and odd distortion, without any "
             "model.", answer),
            ("Distortion of the residual", "The same with the extended model.", after.error))]
    return [
        Section(f"Distortion in {part.path}", (before.sentence(),), rows, pictures),
        Section("Distortion over frequency", (), distortion_rows(answer)),
    ]
