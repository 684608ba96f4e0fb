# SPDX-License-Identifier: BSD-3-Clause
"""A diagnosis that reads files and writes verdict, extended model and report."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from os import PathLike
from pathlib import Path

from piezo_common.budget import Budget, spending, while_time_lasts
from piezo_common.cancellation import check_cancelled
from piezo_common.progress_part import Progress, part_of
from piezo_common.text_file import keep_previous
from piezo_identification.conditioning.waveforms import played
from piezo_identification.diagnosis.diagnose import Diagnosis, diagnose
from piezo_identification.diagnosis.evidence.known_noise import noise_of_model
from piezo_identification.diagnosis.experiment_design.decide import DecisionStep, decide
from piezo_identification.diagnosis.experiment_design.expected_outcome import SURE
from piezo_identification.diagnosis.experiment_design.propose import (
    LONGEST_S,
    OUTCOME,
    WAVEFORM,
    Proposal,
    propose,
    save_proposal,
    what_would_decide,
)
from piezo_identification.diagnosis.joint.identification_recordings import (
    IdentificationRecordings,
    find_identification_recordings,
)
from piezo_identification.diagnosis.report.diagnosis_report import render_report
from piezo_identification.diagnosis.verdict import write_verdict
from piezo_identification.experiments.catalogue import Experiment
from piezo_identification.experiments.stage_limits import StageLimits
from piezo_identification.prediction.outside_identified import outside_identified
from piezo_identification.prediction.row_reading import all_as_identified
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import load_model
from piezo_recorder.reading.reader import only_recording, read_recordings, sha256_of
from piezo_recorder.reading.recording import Recording

READ_FRACTION, DESIGN_FRACTION, REPORT_FRACTION = 0.05, 0.7, 0.9
"""Fractions of the work done before the diagnosis, the next experiment and the report."""

AnyPath = str | PathLike[str]

PlayToFile = Callable[[Experiment, Path, Progress], AnyPath]
"""Takes an experiment, the directory for its recording, and the progress; returns the recording."""


@dataclass(frozen=True)
class GivenFiles:
    """Data to diagnose, as read from files."""

    identified: IdentifiedModel
    model: AnyPath

    recordings: list[Recording]
    """Recordings with rows aligned as in the identification."""

    paths: tuple[AnyPath, ...]
    holdout: Recording | None
    identified_from: IdentificationRecordings

    rows: tuple[str, ...]
    """Sentences on how rows were aligned."""
    directory: Path
    """Folder for the results."""

    def with_recordings(self, paths: Sequence[AnyPath]) -> "GivenFiles":
        """Return the data with more recordings, which are read from their files."""
        more, rows = all_as_identified(
            self.identified, [recording for path in paths for recording in read_recordings(path)])
        return replace(self, recordings=[*self.recordings, *more], paths=(*self.paths, *paths),
                       rows=(*self.rows, *rows))


@dataclass(frozen=True)
class DiagnosisResults:
    """A diagnosis and the files that contain it."""

    diagnosis: Diagnosis
    verdict: Path
    extended_model: Path
    report: Path

    outside: tuple[str, ...] = ()
    """Sentences on how rows were aligned, and on recordings outside the range of the
    identification."""
    identified_from: IdentificationRecordings = IdentificationRecordings()
    """Available recordings from which the model was identified."""
    next_experiment: Proposal | None = None
    """Experiment that would decide between the remaining explanations."""


def diagnose_files(
    model: AnyPath, recordings: Sequence[AnyPath], holdout: AnyPath | None, directory: AnyPath,
    progress: Progress, read_file: Callable[[AnyPath], list[Recording]] = read_recordings,
    identified_from: Sequence[AnyPath] = (), budget: Budget | None = None,
) -> DiagnosisResults:
    """Diagnose recordings and write verdict, extended model and report.

    The errors are measured on `holdout`. The directory is created if it does not exist. `progress`
    is called with (what is done, fraction); an exception that it raises ends the work.
    `identified_from` are the recordings from which the model was identified, if they are not at the
    paths in the model file; for the time limit see `diagnose`. Raise ValueError if a file cannot be
    read or written, or a recording cannot be used.
    """
    budget = budget or Budget()
    progress("read the recordings", 0.0)
    given = read_given(model, recordings, holdout, directory, read_file, identified_from)
    diagnosis = diagnose(given.identified.model, given.recordings, given.holdout,
                         part_of(progress, READ_FRACTION, DESIGN_FRACTION),
                         identified_from=given.identified_from,
                         stated_um=stated_error_um(given.identified),
                         noise=noise_of_model(given.identified), budget=budget)
    proposal = None
    # The verdict is useful even without the experiment that would decide more.
    with spending(budget), while_time_lasts("the experiment that would decide more"):
        check_cancelled()
        proposal = what_would_decide(diagnosis, given.identified_from,
                                     part_of(progress, DESIGN_FRACTION, REPORT_FRACTION))
    if budget.not_tried:
        diagnosis = replace(diagnosis, not_tried=budget.sentence(),
                            selection=replace(diagnosis.selection, interrupted=True))
    progress("write the report", REPORT_FRACTION)
    return write_results(given, diagnosis, proposal)


def read_given(
    model: AnyPath, recordings: Sequence[AnyPath], holdout: AnyPath | None, directory: AnyPath,
    read_file: Callable[[AnyPath], list[Recording]] = read_recordings,
    identified_from: Sequence[AnyPath] = (),
) -> GivenFiles:
    """Read the data to diagnose, and create the directory of the results.

    Raise ValueError if a file cannot be read, or the directory cannot be made.
    """
    identified = load_model(model)
    given = [recording for path in recordings for recording in read_file(path)]
    read, rows = all_as_identified(identified, given)
    held_out = None
    if holdout:
        (held_out,), _ = all_as_identified(
            identified, [only_recording(holdout, read_file(holdout))])
    known = find_identification_recordings(
        identified, model, read_file, identified_from,
        [*recordings, *([holdout] if holdout else [])])
    directory = Path(directory).absolute()
    try:
        # Fails early if the directory cannot be created.
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(f"{directory}: {error.strerror}; choose another directory") from None
    return GivenFiles(identified, model, read, tuple(recordings), held_out, known, tuple(rows),
                      directory)


def write_results(given: GivenFiles, diagnosis: Diagnosis,
                  proposal: Proposal | None = None) -> DiagnosisResults:
    """Write verdict, extended model and report, and the experiment that would decide more."""
    directory, identified = given.directory, given.identified
    if proposal is not None:
        save_proposal(proposal, directory)
        diagnosis = replace(
            diagnosis, next_experiment=proposal.document() | {"file": WAVEFORM})
    else:
        of_earlier_verdict = directory / WAVEFORM, directory / OUTCOME
        for path in filter(Path.exists, of_earlier_verdict):
            keep_previous(path)
    results = DiagnosisResults(
        diagnosis, directory / "verdict.json", directory / "extended_model.json",
        directory / "report.html", (*given.rows, *_outside(identified, given.recordings)),
        given.identified_from, proposal)
    write_verdict(directory, identified, diagnosis, given.paths)
    origin = [("diagnosed", datetime.now().astimezone().isoformat(" ", "seconds")),
              ("model", f"{given.model}, of {identified.created}"),
              *(("outside", sentence) for sentence in results.outside),
              *(("recording", f"{path}, SHA-256 {sha256_of(path)[:16]}") for path in given.paths),
              ("extended model", str(results.extended_model))]
    results.report.write_text(render_report(diagnosis, origin), encoding="utf-8")
    return results


def stated_error_um(identified: IdentifiedModel) -> float | None:
    """Return the known error of a model: the largest residual of its components, RMS beyond noise.

    It is None if the model file contains none, as for responses.
    """
    parts = [max(0.0, part["residual_rms_um"] ** 2 - part["noise_rms_um"] ** 2) ** 0.5
             for name, part in identified.adequacy.items() if name in identified.sample_periods_s]
    return max(parts, default=None)


def _outside(identified: IdentifiedModel, recordings: Sequence[Recording]) -> tuple[str, ...]:
    return tuple(
        f"{recording.path}: {sentence}" for recording in recordings
        for sentence in outside_identified(identified, played(recording).voltage_v).sentences())


def decide_files(model: AnyPath, recordings: Sequence[AnyPath], holdout: AnyPath | None,
                 directory: AnyPath, play: PlayToFile, budget: int, limits: StageLimits,
                 progress: Progress, longest_s: float = LONGEST_S,
                 begin_budget: Callable[[], Budget] = Budget,
                 ) -> tuple[DiagnosisResults, list[DecisionStep]]:
    """Decide by experiments, and write verdict, extended model, report and recordings.

    The arguments are those of `diagnose_files` and `decide`. The files of each proposal and its
    recording are in `experiment_1` and so on. Raise ValueError if a file cannot be read or written,
    or a recording cannot be used.
    """
    progress("read the recordings", 0.0)
    given = read_given(model, recordings, holdout, directory)
    played: list[AnyPath] = []

    def play_proposed(proposal: Proposal, report: Progress) -> Recording:
        nonlocal given
        folder = given.directory / f"experiment_{len(played) + 1}"
        save_proposal(proposal, folder)
        sentence = proposal.sentence()
        path = play(replace(proposal.experiment, description=sentence), folder,
                    lambda what, fraction: report(f"{sentence} {what}", fraction))
        played.append(path)
        given = given.with_recordings([path])
        return given.recordings[-1]

    steps = decide(given.identified.model, given.recordings, play_proposed, budget, limits,
                   longest_s, given.holdout, part_of(progress, READ_FRACTION, REPORT_FRACTION),
                   given.identified_from, stated_error_um(given.identified),
                   noise_of_model(given.identified), begin_budget)
    progress("write the report", REPORT_FRACTION)
    last = steps[-1]
    proposal = None if last.is_decided else propose(last.alternatives, limits, longest_s)
    return write_results(given, last.diagnosis, proposal), steps


def decision_sentence(steps: Sequence[DecisionStep]) -> str:
    """Report what the experiments have decided, and with which probability."""
    last, played = steps[-1], len(steps) - 1
    after = f"after {played} experiment{'s' * (played != 1)}"
    chances = [f"{name} has probability {share:.3f}"
               for name, share in list(last.probabilities.items())[: 1 if last.is_decided else 3]]
    if last.is_decided:
        return f"decided {after}: {chances[0]}"
    return f"not decided {after}, as none has {SURE:g}: {', '.join(chances)}"
