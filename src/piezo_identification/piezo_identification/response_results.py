# SPDX-License-Identifier: BSD-3-Clause
"""A diagnosis of a frequency response from files to files."""

import html
from pathlib import Path

from piezo_identification.diagnosis.verdict import save_extended_model, write_verdict
from piezo_identification.frequency_response import read_frequency_response
from piezo_identification.response_diagnosis import diagnose_response
from piezo_models.model_file import load_model
from piezo_models.picture_style import AFTER, BEFORE, BLACK, WIDE_IN, label, new_figure

PICTURE = "response.png"
DOTS_PER_INCH = 120


def diagnose_response_file(model, response, directory):
    """Diagnose a frequency response and write verdict, extended model, picture and report.

    Parameters
    ----------
    model, response : path-like
    directory : path-like
        Made if it is missing.

    Returns
    -------
    ResponseDiagnosis

    Raises
    ------
    ValueError
        If a file cannot be read or written, or the response cannot be used.
    """
    identified, directory = load_model(model), Path(directory)
    measured = read_frequency_response(response)
    directory.mkdir(parents=True, exist_ok=True)
    diagnosis = diagnose_response(identified.model, measured)
    write_verdict(directory / "verdict.json", diagnosis)
    save_extended_model(directory / "extended_model.json", identified, diagnosis, [response])
    draw_response(directory / PICTURE, diagnosis)
    (directory / "report.html").write_text(_report(diagnosis), encoding="utf-8")
    return diagnosis


def response_sentence(diagnosis):
    """The verdict in a sentence."""
    names = ", then ".join(entry["name"] for entry in diagnosis.effects)
    if diagnosis.verdict == "none":
        return "The model explains the response: what is left is noise."
    found = f"The model lacks {names}." if names else "No linear effect explains what is left."
    return f"{found} {diagnosis.left}".strip()


def draw_response(path, diagnosis):
    """Measured gain beside that of the model and of the extended one, and the two errors."""
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
    figure.savefig(path, dpi=DOTS_PER_INCH)


def _report(diagnosis):
    rows = "".join(
        f"<tr><td>{name}</td><td>{diagnosis.before[name]:.4g}</td>"
        f"<td>{diagnosis.after[name]:.4g}</td></tr>" for name in diagnosis.before)
    effects = "".join(
        f"<li>{html.escape(entry['name'])}: {html.escape(str(entry['parameters']))}, "
        f"{entry['error_reduction_percent']:.1f} % off the error</li>"
        for entry in diagnosis.effects)
    tried = "".join(
        "<li>" + ", ".join(f"{name} {reduction:.1f} %" for name, reduction in round_) + "</li>"
        for round_ in diagnosis.tried)
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>Diagnosis of a frequency response</title></head>
<body><h1>{diagnosis.verdict}</h1><p>{html.escape(response_sentence(diagnosis))}</p>
<table><tr><th>on frequencies held out</th><th>before</th><th>after</th></tr>{rows}</table>
<ul>{effects}</ul><img src="{PICTURE}" alt="measured and modelled response">
<p>Tried in each round, and how much of the error held out it took off:</p><ol>{tried}</ol>
</body></html>
"""
