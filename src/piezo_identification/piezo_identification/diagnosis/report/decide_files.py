# SPDX-License-Identifier: BSD-3-Clause
"""A decision that reads files, and saves its proposals and recordings next to the verdict."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path

from piezo_common.budget import Budget
from piezo_common.progress_part import Progress, part_of
from piezo_identification.diagnosis.evidence.known_noise import noise_of_model
from piezo_identification.diagnosis.experiment_design.decide import DecisionStep, decide
from piezo_identification.diagnosis.experiment_design.expected_outcome import SURE
from piezo_identification.diagnosis.experiment_design.propose import (
    LONGEST_S,
    Proposal,
    propose,
    save_proposal,
)
from piezo_identification.diagnosis.report.diagnosis_results import (
    READ_FRACTION,
    REPORT_FRACTION,
    DiagnosisResults,
    read_given,
    stated_error_um,
    write_results,
)
from piezo_identification.experiments.catalogue import Experiment
from piezo_identification.experiments.stage_limits import StageLimits
from piezo_recorder.reading.recording import Recording

AnyPath = str | PathLike[str]
PlayToFile = Callable[[Experiment, Path, Progress], AnyPath]
"""Takes an experiment, the directory for its recording, and the progress; returns the recording."""


def decide_files(model: AnyPath, recordings: Sequence[AnyPath], holdout: AnyPath | None,
                 directory: AnyPath, play: PlayToFile, budget: int, limits: StageLimits,
                 progress: Progress, longest_s: float = LONGEST_S,
                 begin_budget: Callable[[], Budget] = Budget,
                 ) -> tuple[DiagnosisResults, list[DecisionStep]]:
    """Decide by experiments, and write verdict, extended model, report and recordings.

    The files of each proposal and its recording are in `experiment_1` and so on.

    Parameters
    ----------
    model, recordings, holdout, directory, progress
        As in `diagnose_files`.
    budget, longest_s, begin_budget
        As in `decide`.

    Raises
    ------
    ValueError
        If a file cannot be read or written, or a recording cannot be used.
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
