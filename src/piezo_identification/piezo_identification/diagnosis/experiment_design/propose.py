# SPDX-License-Identifier: BSD-3-Clause
"""Design of the recording that distinguishes the alternative explanations of a diagnosis."""

import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_common.progress_part import Progress, part_of
from piezo_common.side_by_side import side_by_side
from piezo_common.text_file import replace_json, replace_text
from piezo_identification.diagnosis.diagnose import Diagnosis, condition
from piezo_identification.diagnosis.experiment_design.alternative_explanations import (
    Alternatives,
    effects_of,
    find_alternatives,
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
from piezo_identification.experiments.input_designs import (
    HIGHEST_OF_CLOCK,
    random_phase_multisine,
)
from piezo_identification.experiments.stage_limits import USUAL_LIMITS, StageLimits
from piezo_identification.fitting.dataset import Dataset, simulate_recordings
from piezo_identification.fitting.regression import first_regression, reweighted
from piezo_models.cascade import StageModel
from piezo_recorder.reading.recording import Recording

SLOW_SAMPLES = 30_000
"""Approximate number of samples of a slow waveform: what a diagnosis fits of one recording."""
ROUNDED = 41
"""Number of samples over which an edge of a slow waveform is smoothed."""
FAST_S = 2.0
FEWEST_SAMPLES = 1000
"""Rows of a fast waveform with a slow clock: twice what a comparison needs, as half may settle."""
MOST_OF_RANGE = 0.95
LONGEST_S = 30.0

FACTORS = (1.6, 1.25)
"""Factors by which level and rate of the best waveform of the grid are varied, in turn."""

WAVEFORM, OUTCOME = "next_experiment.csv", "next_experiment.json"
"""File names of a proposal."""

COMPARED = 0.3
"""Part of the work for estimating the alternatives, to report progress."""


@dataclass(frozen=True)
class Family:
    """A family of waveforms, from which an experiment is chosen by its level and its rate.

    Slow waveforms last for the whole time allowed, with samples held for milliseconds; fast ones
    last for a second or two at the sample clock.
    """

    name: str

    levels: tuple[float, ...]
    """Fractions of the voltage range that are tried."""
    rates: tuple[float, ...]
    """Rates in Hz: the frequency of triangles, the number of steps per second, the highest
    frequency of multisines and sweeps."""
    fast: bool
    """Whether it is played at the sample clock."""
    shape: Callable[[FloatArray, float], FloatArray]
    """Returns the wave between -1 and 1 for time in s, shape (N,), and rate."""


def _triangles(time_s: FloatArray, rate_hz: float) -> FloatArray:
    """Triangles whose amplitude rises until the middle of the time and falls again."""
    triangle = 4.0 * np.abs((rate_hz * time_s + 0.25) % 1.0 - 0.5) - 1.0
    position = time_s / time_s[-1]
    return triangle * (0.1 + 0.9 * (1.0 - np.abs(2.0 * position - 1.0)))


def _steps(time_s: FloatArray, rate_hz: float) -> FloatArray:
    """Random levels, each held for a random time."""
    random = np.random.default_rng(0)
    count = max(2, round(rate_hz * time_s[-1]))
    holds = random.uniform(0.3, 1.7, count)
    edges_s = np.cumsum(holds)[:-1] * time_s[-1] / holds.sum()
    return random.uniform(-1.0, 1.0, count)[np.searchsorted(edges_s, time_s, side="right")]


def _rest_and_creep(time_s: FloatArray, rate_hz: float) -> FloatArray:
    """Rest, a step up and a rest, a step down and a rest: drift continues, creep restarts."""
    rate_hz = max(rate_hz, 1.0 / float(time_s[-1]))
    return np.where((rate_hz * time_s + 0.75) % 1.0 < 0.5, 1.0, -1.0) * np.where(
        rate_hz * time_s < 0.25, 0.0, 1.0)


def _sweep(time_s: FloatArray, highest_hz: float) -> FloatArray:
    """Sine with a frequency that rises over two and a half decades."""
    ratio, duration_s = np.log(300.0), time_s[-1]
    first_hz = highest_hz / 300.0
    return np.sin(2.0 * np.pi * first_hz * duration_s / ratio
                  * np.expm1(ratio * time_s / duration_s))


def _multisine(time_s: FloatArray, highest_hz: float) -> FloatArray:
    """Two periods of a multisine with all lines up to the highest frequency."""
    samples = time_s.size // 2
    period_s = samples * float(time_s[1] - time_s[0])
    lines = np.arange(1, max(2, round(highest_hz * period_s)) + 1)
    wave = random_phase_multisine(lines, samples, np.random.default_rng(0))
    return np.asarray(np.resize(wave, time_s.size))


FAMILIES = (
    Family("triangles", (0.3, 0.9), (0.2, 2.0), False, _triangles),
    Family("steps", (0.3, 0.8), (0.3, 2.0), False, _steps),
    Family("rest_and_creep", (0.3, 0.8), (0.035, 0.1), False, _rest_and_creep),
    Family("slow_sweep", (0.3, 0.9), (30.0,), False, _sweep),
    Family("fast_triangles", (0.2, 0.7), (20.0, 100.0), True, _triangles),
    Family("fast_steps", (0.1, 0.35), (50.0, 200.0), True, _steps),
    Family("sweep", (0.1, 0.4), (500.0, 3000.0), True, _sweep),
    Family("multisine", (0.2, 0.6), (300.0, 3000.0), True, _multisine),
)


def _rounded(wave: FloatArray) -> FloatArray:
    """Smooth the edges, so that fast errors of a model between slow samples do not matter."""
    window = np.hanning(ROUNDED + 2)[1:-1]
    padded = np.concatenate([np.full(ROUNDED // 2, wave[0]), wave,
                             np.full(ROUNDED - 1 - ROUNDED // 2, wave[-1])])
    return np.asarray(np.convolve(padded, window / window.sum(), mode="valid"))


@dataclass(frozen=True)
class Point:
    """One waveform of a family."""

    family: Family

    level: float
    """Fraction of the voltage range."""
    rate_hz: float
    """Reduced if the sample clock requires it."""

    def neighbours(self, factor: float) -> "list[Point]":
        """Return the points with the level or the rate multiplied or divided by a factor."""
        return [replace(self, level=min(MOST_OF_RANGE, self.level * factor)),
                replace(self, level=self.level / factor),
                replace(self, rate_hz=self.rate_hz * factor),
                replace(self, rate_hz=self.rate_hz / factor)]


def grid() -> list[Point]:
    """Return the points of all families on their grids."""
    return [Point(family, level, rate_hz) for family in FAMILIES for level in family.levels
            for rate_hz in family.rates]


def waveform(limits: StageLimits, longest_s: float, point: Point) -> Experiment:
    """Make a waveform as large as its level and the slew limit allow."""
    family = point.family
    clock_s = 1.0 / limits.sample_rate_hz
    period_s = clock_s
    if not family.fast:
        period_s = clock_s * max(1, round(longest_s / SLOW_SAMPLES / clock_s))
    fast_s = max(FAST_S, FEWEST_SAMPLES * clock_s)
    duration_s = min(longest_s, fast_s) if family.fast else longest_s
    time_s = period_s * np.arange(round(duration_s / period_s), dtype=np.float64)
    rate_hz = min(point.rate_hz, HIGHEST_OF_CLOCK / period_s)
    wave = family.shape(time_s, rate_hz)
    if not family.fast:
        wave = _rounded(wave)
    step = float(np.abs(np.diff(wave)).max())
    amplitude_v = min(0.5 * point.level * limits.span_v, limits.largest_step_v / max(step, 1e-12))
    return Experiment(
        f"{family.name}_{point.level:.3g}_{rate_hz:.4g}Hz",
        limits.clip(limits.middle_v + amplitude_v * wave), period_s, 1,
        f"{family.name.replace('_', ' ')} of {2.0 * amplitude_v:.3g} V, {rate_hz:.3g} Hz")


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
    rounds = 1 + len(FACTORS)

    def tried(point: Point, is_refitted: bool = True) -> Proposal:
        experiment = waveform(limits, longest_s, point)
        outcome = expected_outcome(alternatives, experiment, limits, is_refitted)
        return Proposal(experiment, alternatives, outcome, point)

    def best_of(points: Sequence[Point], number: int, best: Proposal | None = None) -> Proposal:
        """Return the best of a proposal, if there is one, and the waveforms of some points.

        With fixed parameters a waveform seems to distinguish at least as well as it does. They are
        refitted only where it would then be the best.
        """
        def report(place: int) -> None:
            part_of(progress, number / rounds, (number + 1) / rounds)(
                f"try {points[place].family.name.replace('_', ' ')}", place / len(points))

        fixed = side_by_side(lambda point: tried(point, is_refitted=False), points, report)
        best = best or tried(max(fixed, key=_rank).point)
        hopeful = [each.point for each in fixed
                   if _rank(each) > _rank(best) and each.point != best.point]
        return max([best, *side_by_side(tried, hopeful)], key=_rank)

    best = best_of(grid(), 0)
    for number, factor in enumerate(FACTORS, 1):
        best = best_of(best.point.neighbours(factor), number, best)
    return best


def save_proposal(proposal: Proposal, directory: Path) -> tuple[Path, Path]:
    """Write the waveform and its expected outcome to a directory, which is created if necessary.

    Return the paths of `next_experiment.csv`, with the columns time_s,voltage_v, and of
    `next_experiment.json`.
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


def several_remain(verdict: Mapping[str, Any]) -> bool:
    """Return whether a verdict (`verdict.json`) leaves several known explanations to decide.

    It does not if something else is most probable, because no known effect predicts it.
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
    """Design the recording that decides between the alternatives of a diagnosis, if any."""
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
