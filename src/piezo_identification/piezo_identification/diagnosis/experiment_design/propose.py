# SPDX-License-Identifier: BSD-3-Clause
"""Design of the recording that distinguishes the alternative explanations of a diagnosis."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from piezo_common.progress_part import Progress, part_of
from piezo_common.side_by_side import side_by_side
from piezo_common.text_file import replace_json, replace_text
from piezo_identification.diagnosis.diagnose import Diagnosis, condition
from piezo_identification.diagnosis.experiment_design.alternative_explanations import (
    Alternatives,
    effects_of,
    find_alternatives,
)
from piezo_identification.diagnosis.experiment_design.candidate_waveforms import (
    Point,
    grid,
    waveform,
)
from piezo_identification.diagnosis.experiment_design.expected_outcome import (
    SURE,
    ExpectedOutcome,
    expected_outcome,
)
from piezo_identification.diagnosis.joint.identification_recordings import (
    IdentificationRecordings,
    old_recordings,
)
from piezo_identification.diagnosis.joint.probabilities import ALTERNATIVE, BELIEVED, SOMETHING_ELSE
from piezo_identification.experiments.catalogue import Experiment
from piezo_identification.experiments.stage_limits import USUAL_LIMITS, StageLimits
from piezo_identification.fitting.dataset import Dataset, simulate_recordings
from piezo_identification.fitting.regression import first_regression, reweighted
from piezo_models.cascade import StageModel
from piezo_recorder.reading.recording import Recording

LONGEST_S = 30.0
FACTORS = (1.6, 1.25)
"""Factors by which level and rate of the best waveform of the grid are varied, in turn."""

WAVEFORM, OUTCOME = "next_experiment.csv", "next_experiment.json"
"""File names of a proposal."""


@dataclass(frozen=True, eq=False)
class Proposal:
    """The waveform to play next, and its expected outcome."""

    experiment: Experiment
    alternatives: Alternatives
    outcome: ExpectedOutcome

    point: Point
    """Family, level and rate of the waveform."""

    def document(self) -> dict[str, Any]:
        """Return the content of the file with the expected outcome."""
        names = [alternative.name for alternative in self.alternatives.alternatives]
        return {
            "waveform": self.experiment.name, "description": self.experiment.description,
            "kind": self.point.family.name, "level": self.point.level,
            "rate_hz": self.point.rate_hz,
            "lowest_v": float(self.experiment.voltage_v.min()),
            "highest_v": float(self.experiment.voltage_v.max()),
            "duration_s": self.experiment.duration_s,
            "sample_period_s": self.experiment.sample_period_s,
            "probability_of_deciding": self.outcome.probability,
            "alternatives": [
                {"effects": name, "probability": self.alternatives.alternatives[index].probability,
                 "probability_of_deciding": float(self.outcome.deciding[index]),
                 "expected_rms_difference_um": {
                     other: float(self.outcome.rms_um[index, number])
                     for number, other in enumerate(names) if number != index}}
                for index, name in enumerate(names)],
        }

    def sentence(self) -> str:
        """Describe what the recording is expected to decide."""
        names = " from ".join(each.name for each in self.alternatives.alternatives[:2])
        apart_um = self.outcome.rms_um[0, 1]
        return (f"{self.experiment.description}, for {self.experiment.duration_s:.3g} s, "
                f"distinguishes {names} with probability {self.outcome.probability:.2f}: "
                f"their predictions differ by {1e3 * apart_um:.3g} nm RMS.")


def alternatives_of_files(model: StageModel, recordings: Sequence[Recording],
                          verdict: Mapping[str, Any],
                          identified_from: IdentificationRecordings | None = None,
                          stated_um: float = 0.0) -> Alternatives:
    """Fit the explanations that a verdict leaves open to the diagnosed recordings.

    Parameters
    ----------
    verdict : dict
        Content of `verdict.json`.
    identified_from : IdentificationRecordings, optional
        Available recordings from which the model was identified; by default none.
    stated_um : float
        RMS of the known error of the model.

    Examples
    --------
    >>> verdict = diagnose(model, [recording]).document()    # the example of `diagnose`
    >>> alternatives = alternatives_of_files(model, [recording], verdict)
    >>> sorted(each.name for each in alternatives.alternatives)
    ['amplifier_lag', 'sensor_lag']
    """
    given = condition(model, recordings, None)
    first = first_regression(simulate_recordings(model, given.recordings))
    old = old_recordings(model, identified_from or IdentificationRecordings())
    return find_alternatives(
        reweighted(first, effects_of(verdict)), verdict, old, stated_um=stated_um)


def propose(alternatives: Alternatives, limits: StageLimits, longest_s: float = LONGEST_S,
            progress: Progress | None = None) -> Proposal | None:
    """Find the waveform that distinguishes alternatives most reliably.

    All families are tried on a grid of level and rate, and the best is refined.

    Parameters
    ----------
    limits : StageLimits
        Limits of the waveform; the voltage range of the model applies as well.
    longest_s : float
        Longest duration of the waveform.

    Returns
    -------
    Proposal or None
        None if only one alternative remains.

    Raises
    ------
    ValueError
        If the limits and the model's voltage range do not overlap.

    Examples
    --------
    >>> from piezo_identification import StageLimits
    >>> limits = StageLimits(0.0, 10.0, sample_rate_hz=100.0)
    >>> proposal = propose(alternatives, limits)     # those of `alternatives_of_files`
    >>> print("waveform:", proposal.sentence())
    waveform: ... distinguishes amplifier_lag from sensor_lag with probability ...
    """
    if len(alternatives.alternatives) < 2:
        return None
    limits = _within_model(limits, alternatives.problem.dataset.model)
    points = grid()
    steps, done = len(points) + 4 * len(FACTORS), 0

    def tried(point: Point) -> Proposal:
        experiment = waveform(limits, longest_s, point)
        outcome = expected_outcome(alternatives, experiment, limits)
        return Proposal(experiment, alternatives, outcome, point)

    def report(number: int) -> None:
        if progress is not None:
            progress(f"try {points[number].family.name.replace('_', ' ')}", (done + number) / steps)

    best = max(side_by_side(tried, points, report), key=_rank)
    for factor in FACTORS:
        done, points = done + len(points), best.point.neighbours(factor)
        best = max([best, *side_by_side(tried, points, report)], key=_rank)
    return best


def save_proposal(proposal: Proposal, directory: Path) -> tuple[Path, Path]:
    """Write the waveform and its expected outcome.

    Parameters
    ----------
    directory : Path
        Created if it does not exist.

    Returns
    -------
    waveform, outcome : Path
        `next_experiment.csv` with the columns time_s,voltage_v, and `next_experiment.json`.
    """
    directory.mkdir(parents=True, exist_ok=True)
    experiment = proposal.experiment
    voltage_v = np.tile(experiment.voltage_v, experiment.repeats)
    time_s = experiment.sample_period_s * np.arange(voltage_v.size)
    paths = directory / WAVEFORM, directory / OUTCOME
    table = io.StringIO()
    np.savetxt(table, np.column_stack([time_s, voltage_v]), "%.9g", ",",
               header="time_s,voltage_v", comments="")
    replace_text(paths[0], table.getvalue())
    replace_json(paths[1], proposal.document())
    return paths


def _rank(proposal: Proposal) -> tuple[float, ...]:
    return proposal.outcome.rank


def _within_model(limits: StageLimits, model: StageModel) -> StageLimits:
    """Return the limits reduced to the voltage range of the model."""
    lowest_v = max(limits.voltage_min_v, model.hysteresis.voltage_min_v)
    highest_v = min(limits.voltage_max_v, model.hysteresis.voltage_max_v)
    if lowest_v >= highest_v:
        raise ValueError(
            f"the stage allows {limits.voltage_min_v:g}..{limits.voltage_max_v:g} V and the model "
            f"is for {model.hysteresis.voltage_min_v:g}..{model.hysteresis.voltage_max_v:g} V: "
            "give limits within the model's")
    return replace(limits, voltage_min_v=lowest_v, voltage_max_v=highest_v)


COMPARED = 0.3
"""Part of the work for estimating the alternatives."""


def several_remain(verdict: Mapping[str, Any]) -> bool:
    """Return whether a verdict (`verdict.json`) leaves several known explanations to decide.

    Returns
    -------
    bool
        Also False if something else is most probable, because no known effect predicts it.
    """
    shares = dict(verdict.get("probabilities") or {})
    if shares.pop(SOMETHING_ELSE, 0.0) >= BELIEVED:
        return False
    likely = [share for share in shares.values() if share >= ALTERNATIVE]
    if likely and max(likely) < SURE * sum(likely):
        return True
    return bool(verdict.get("not_told_from"))


def what_would_decide(diagnosis: Diagnosis, identified_from: IdentificationRecordings,
                      progress: Progress) -> Proposal | None:
    """Design the recording that decides between the alternatives of a diagnosis.

    Returns
    -------
    Proposal or None
        None if fewer than two alternatives remain.
    """
    verdict = diagnosis.document()
    if diagnosis.selection.interrupted or not several_remain(verdict):
        return None
    regression = diagnosis.selection.regression
    progress("compare the alternatives", 0.0)
    alternatives = find_alternatives(
        regression, verdict, old_recordings(regression.dataset.model, identified_from),
        stated_um=diagnosis.stated_um)
    return propose(alternatives, recorded_limits(regression.dataset),
                   progress=part_of(progress, COMPARED, 1.0))


def recorded_limits(dataset: Dataset) -> StageLimits:
    """Return the voltages of the model as limits, and the clock of the fastest recording."""
    hysteresis = dataset.model.hysteresis
    lowest_v, highest_v = hysteresis.voltage_min_v, hysteresis.voltage_max_v
    return replace(
        USUAL_LIMITS, voltage_min_v=lowest_v, voltage_max_v=highest_v,
        rest_voltage_v=min(max(USUAL_LIMITS.rest_voltage_v, lowest_v), highest_v),
        sample_rate_hz=max(recording.sample_rate_hz for recording in dataset.recordings))
