# SPDX-License-Identifier: BSD-3-Clause
"""Explain a change of a stage in a background process with low priority."""

import json
import multiprocessing
import os
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from piezo_common.text_file import replace_json
from piezo_identification.diagnosis.report.diagnosis_results import diagnose_files
from piezo_identification.monitoring.changed_parameters import changed_parameters
from piezo_models.model_file import load_model, save_model
from piezo_recorder.reading.reader import origin_of, read_recording
from piezo_recorder.reading.recording import Recording
from piezo_recorder.writing.convert import write_recording

NICENESS = 10
"""Niceness of the process, so that a control loop on the same computer has priority."""

EXPLAINED = 0.1
"""Largest fraction of the added residual power that may remain after an explanation."""

RESULT = "change.json"


@dataclass(frozen=True)
class ChangeExplanation:
    """The explanation of a change, as far as one was found."""

    sentence: str
    """Description for users."""
    extended_model: str = ""
    """Path of the model that explains the change; empty if there is none."""
    before_rms_um: float = 0.0
    after_rms_um: float = 0.0
    """RMS of the residual on held-out samples without and with the extended model; equal if there
    is none."""


def explain_change(model: str | Path, recording: str | Path, directory: str | Path,
                   usual_rms_um: float) -> ChangeExplanation:
    """Explain a change by changed parameters of the model, or else by missing effects.

    Parameters
    ----------
    directory : path-like
        Directory for ``extended_model.json``, and for the files of the diagnosis if one is made.
    usual_rms_um : float
        RMS of the model's residual before the change.

    Raises
    ------
    ValueError
        If a file cannot be used.
    """
    identified, directory = load_model(model), Path(directory)
    found = changed_parameters(identified.model, read_recording(recording))
    directory.mkdir(parents=True, exist_ok=True)
    if found.changes and _explains(found.before_rms_um, found.after_rms_um, usual_rms_um):
        path = directory / "extended_model.json"
        save_model(path, replace(
            identified, model=found.model, uncertainties={}, adequacy={},
            errors={**identified.errors, "before_change": {"rms_um": found.before_rms_um},
                    "after_change": {"rms_um": found.after_rms_um}},
            recordings=[*identified.recordings, origin_of(recording)]))
        return ChangeExplanation(found.sentence, str(path), found.before_rms_um, found.after_rms_um)
    results = diagnose_files(model, [recording], None, directory, lambda stage, fraction: None)
    before_um, after_um = (float(state["rms_um"]) for state in (
        results.diagnosis.before, results.diagnosis.after))
    names = ", ".join(entry["name"] for entry in results.diagnosis.effects)
    if names and _explains(before_um, after_um, usual_rms_um):
        return ChangeExplanation(
            f"the model lacks {names}: the residual falls from {1e3 * before_um:.3g} to "
            f"{1e3 * after_um:.3g} nm", str(results.extended_model), before_um, after_um)
    return ChangeExplanation(
        f"{found.sentence}; the verdict of the diagnosis is {results.diagnosis.verdict}"
        + (f" ({names})" if names else "") + f": see {results.report}", "", before_um, before_um)


class Explainer:
    """Explain a change in a separate process.

    Raises
    ------
    OSError
        If the recording cannot be written.
    """

    def __init__(self, model: str, recording: Recording, directory: Path,
                 usual_rms_um: float) -> None:
        self._result = directory / RESULT
        directory.mkdir(parents=True, exist_ok=True)
        path = directory / "after_change"
        write_recording(recording, path)
        # Spawn, as a fork would copy the locks that threads of the middleware hold.
        self._process = multiprocessing.get_context("spawn").Process(
            target=_work, args=(model, str(path), str(directory), usual_rms_um), daemon=True)
        self._process.start()

    @property
    def explanation(self) -> ChangeExplanation | None:
        """Return the explanation; None while the process runs."""
        if self._process.is_alive():
            return None
        try:
            return ChangeExplanation(**json.loads(self._result.read_text(encoding="utf-8")))
        except OSError:
            return ChangeExplanation(
                f"the diagnosis ended without a result (status {self._process.exitcode}): "
                f"run diagnose on {self._result.parent / 'after_change'}")

    def end(self) -> None:
        """Terminate the process, even if it has no result yet."""
        self._process.terminate()
        self._process.join()


def _work(model: str, recording: str, directory: str, usual_rms_um: float) -> None:
    os.nice(NICENESS)
    try:
        explanation = explain_change(model, recording, directory, usual_rms_um)
    except ValueError as error:
        explanation = ChangeExplanation(f"the change cannot be diagnosed: {error}")
    replace_json(Path(directory, RESULT), asdict(explanation))


def _explains(before_um: float, after_um: float, usual_um: float) -> bool:
    added_um2 = before_um**2 - usual_um**2
    return added_um2 > 0.0 and after_um**2 - usual_um**2 <= EXPLAINED * added_um2
