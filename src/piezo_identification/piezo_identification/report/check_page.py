# SPDX-License-Identifier: BSD-3-Clause
"""The page of a check: the measured properties of each recording, and its possible uses."""

from collections.abc import Sequence
from html import escape

from matplotlib.figure import Figure

from piezo_common.report_page import Section, pictured, render_page
from piezo_identification.recording_check.check import RecordingCheck
from piezo_identification.recording_check.check_report import measured_rows
from piezo_identification.recording_check.suitability import Suitability


def check_page(
    checks: Sequence[tuple[str, RecordingCheck, dict[str, Suitability], Figure]],
) -> str:
    """Return the page of one check or several as HTML.

    Parameters
    ----------
    checks : sequence of (str, RecordingCheck, dict of str to Suitability, Figure)
        Title of the recording, its measured properties, its suitability for each experiment, and
        its figure from `check_picture.check_figure`.
    """
    count = len(checks)
    title = (checks[0][0] + ": " + suitability_sentence(checks[0][2])) if count == 1 else (
        f"What {count} recordings can be used for")
    sections = [section for name, check, fit_for, figure in checks for section in _sections(
        name, f"{name}: {suitability_sentence(fit_for)}" if count > 1 else "What it can stand for",
        check, fit_for, figure)]
    return render_page(title, [
        "The noise is the lowest estimate from rests, repeats and the highest frequencies. "
        "The drift is that at one voltage over the whole recording."], sections)


def suitability_sentence(fit_for: dict[str, Suitability]) -> str:
    """Return a phrase that lists the experiments for which a recording is suitable."""
    by_verdict = {verdict: [name for name, each in fit_for.items() if each.verdict == verdict]
                  for verdict in ("yes", "partly")}
    parts = []
    if by_verdict["yes"]:
        parts.append(f"good for {', '.join(by_verdict['yes'])}")
    if by_verdict["partly"]:
        parts.append(f"partly for {', '.join(by_verdict['partly'])}")
    return "; ".join(parts) or "good for none of the experiments"


def _sections(name: str, title: str, check: RecordingCheck,
              fit_for: dict[str, Suitability], figure: Figure) -> list[Section]:
    good_for = [("can stand for", "verdict", "because"),
                *((experiment, each.verdict, each.reason)
                  for experiment, each in fit_for.items())]
    rows = [("measured", "value"), *measured_rows(check)]
    return [
        Section(title, check.warnings, good_for, [
            pictured(name, figure, "Displacement and voltage over time; below, what "
                     f"a voltage of this kind shows ({escape(check.waveform.kind)}).",
                     wide=True, closer=True)]),
        Section("What was measured", table=rows)]
