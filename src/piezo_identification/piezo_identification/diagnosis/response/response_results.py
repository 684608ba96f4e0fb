# SPDX-License-Identifier: BSD-3-Clause
"""Diagnosis of a frequency response from a file, with results written to files."""

from os import PathLike
from pathlib import Path

from matplotlib.figure import Figure

from piezo_common.budget import Budget
from piezo_common.picture_style import AFTER, BEFORE, BLACK, WIDE_IN, label, new_figure, to_png
from piezo_common.progress_part import Progress
from piezo_common.report_page import Section, pictured, render_page
from piezo_identification.diagnosis.evidence.effect_entries import name_of
from piezo_identification.diagnosis.response.response_diagnosis import (
    ResponseDiagnosis,
    diagnose_response,
)
from piezo_identification.diagnosis.verdict import write_verdict
from piezo_identification.estimators.frequency_response.response_file import read_frequency_response
from piezo_identification.report.parameter_table import effect_rows
from piezo_models.model_file import load_model

PICTURE = "response.png"
DOTS_PER_INCH = 120


def diagnose_response_file(
    model: str | PathLike[str], response: str | PathLike[str], directory: str | PathLike[str],
    hold_s: float = 0.0, progress: Progress = lambda what, fraction: None,
    budget: Budget | None = None,
) -> ResponseDiagnosis:
    """Diagnose a frequency response and write verdict, extended model, picture and report.

    Parameters
    ----------
    directory : path-like
        Created if it does not exist.
    hold_s : float
        Sample period of a hold in the response, in s; see `FrequencyResponse`.
    progress, budget
        As in `diagnose_response`.

    Raises
    ------
    ValueError
        If a file cannot be read or written, or the response cannot be used.
    """
    identified, directory = load_model(model), Path(directory)
    measured = read_frequency_response(Path(response)).held(hold_s)
    directory.mkdir(parents=True, exist_ok=True)
    diagnosis = diagnose_response(identified.model, measured, progress, budget)
    write_verdict(directory, identified, diagnosis, [response])
    (directory / PICTURE).write_bytes(to_png(response_figure(diagnosis), DOTS_PER_INCH))
    (directory / "report.html").write_text(_report(diagnosis), encoding="utf-8")
    return diagnosis


def response_sentence(diagnosis: ResponseDiagnosis) -> str:
    """Return the verdict in a sentence."""
    names = ", then ".join(map(name_of, diagnosis.effects))
    if diagnosis.verdict == "none":
        who = "The model"
        if diagnosis.after != diagnosis.before:
            who = "No effect is missing: the model with slightly other dynamics"
        return f"{who} explains the response: what remains passes for noise."
    found = f"The model lacks {names}." if names else "No linear effect explains the residual."
    return f"{found} {diagnosis.left}".strip()


def response_figure(diagnosis: ResponseDiagnosis) -> Figure:
    """Draw the measured gain with those of the model and the extended model, and the errors."""
    figure = new_figure(6.0, WIDE_IN)
    gains, errors = figure.subplots(2, 1, sharex=True)
    frequency_hz, measured = diagnosis.measured.frequency_hz, diagnosis.measured.gain
    gains.loglog(frequency_hz, abs(measured), color=BLACK, linestyle="none", marker=".",
                 markersize=3, label="measured")
    for gain, style in ((diagnosis.before_gain, BEFORE | {"label": "model"}),
                        (diagnosis.after_gain, AFTER | {"label": "extended"})):
        gains.loglog(frequency_hz, abs(gain), **style)
        errors.loglog(frequency_hz, 100.0 * abs(gain / measured - 1.0), **style)
    gains.legend()
    label(gains, y="gain (unit of the data)")
    label(errors, "frequency (Hz)", "error (% of the gain)")
    return figure


def _report(diagnosis: ResponseDiagnosis) -> str:
    rows = [("on frequencies held out", "before", "after"),
            *((name, f"{diagnosis.before[name]:.3g}", f"{diagnosis.after[name]:.3g}")
              for name in diagnosis.before)]
    sections = [Section("What was found", table=rows, pictures=(pictured(
        "Response", response_figure(diagnosis), "The gain, measured and modelled, and the errors.",
        wide=True, closer=True),))]
    if diagnosis.effects:
        sections.append(Section("What was added", table=effect_rows(diagnosis.effects)))
    sections.append(Section("What was tried", [
        f"Round {number}, and by how much each reduced the held-out error: "
        + ", ".join(f"{name} {reduction:.1f} %" for name, reduction in attempts)
        for number, attempts in enumerate(diagnosis.tried, 1)]
        + [f"It ended early: {each}." for each in filter(None, [diagnosis.not_tried])]))
    return render_page(f"{diagnosis.verdict}: {response_sentence(diagnosis)}", (), sections)
