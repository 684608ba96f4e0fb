# SPDX-License-Identifier: BSD-3-Clause
"""Play what distinguishes the alternatives, and diagnose again, until one remains."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from piezo_common.budget import Budget
from piezo_common.progress_part import Progress, part_of
from piezo_identification.diagnosis.diagnose import Diagnosis, diagnose
from piezo_identification.diagnosis.evidence.known_noise import KnownNoise
from piezo_identification.diagnosis.experiment_design.alternative_explanations import (
    Alternatives,
    find_alternatives,
)
from piezo_identification.diagnosis.experiment_design.decided_verdict import decided_verdict
from piezo_identification.diagnosis.experiment_design.expected_outcome import SURE
from piezo_identification.diagnosis.experiment_design.propose import LONGEST_S, Proposal, propose
from piezo_identification.diagnosis.joint.identification_recordings import (
    IdentificationRecordings,
    old_recordings,
)
from piezo_identification.experiments.stage_limits import USUAL_LIMITS, StageLimits
from piezo_models.cascade import StageModel
from piezo_recorder.reading.recording import Recording

DIAGNOSED, COMPARED, DESIGNED = 0.6, 0.7, 0.8
"""Fractions of the work of a step done after its diagnosis, its comparison, and its design."""


@dataclass(frozen=True, eq=False)
class DecisionStep:
    """A diagnosis on the way to a decision."""

    diagnosis: Diagnosis
    """Diagnosis of all recordings so far, with the probabilities of the alternatives."""
    alternatives: Alternatives
    """Remaining alternatives."""
    proposal: Proposal | None
    """What was played next; None if a decision was made or the budget is spent."""

    @property
    def probabilities(self) -> dict[str, float]:
        """Return the probability of each alternative by name."""
        return self.alternatives.probabilities

    @property
    def is_decided(self) -> bool:
        """Return whether one alternative is sufficiently probable, or the only one."""
        return _is_decided(self.alternatives)


Play = Callable[[Proposal, Progress], Recording]


def decide(model: StageModel, recordings: Sequence[Recording], play: Play, budget: int,
           limits: StageLimits = USUAL_LIMITS, longest_s: float = LONGEST_S,
           holdout: Recording | None = None, progress: Progress | None = None,
           identified_from: IdentificationRecordings | None = None,
           stated_um: float | None = None, noise: KnownNoise | None = None,
           begin_budget: Callable[[], Budget] = Budget) -> list[DecisionStep]:
    """Diagnose, play what distinguishes the alternatives, and diagnose again.

    Parameters
    ----------
    play : callable
        Takes a proposal and a progress function called with (what is done, fraction); plays the
        experiment on the stage and returns the recording.
    budget : int
        Largest number of recordings.
    longest_s : float
        Longest duration of each.
    holdout, progress, identified_from, stated_um, noise
        As in `diagnose`.
    begin_budget : callable
        Returns the time limit of a diagnosis, counted from the call.

    Returns
    -------
    list of DecisionStep
        The last one contains the decision, if there is one.

    Examples
    --------
    >>> import numpy as np
    >>> from piezo_models import (
    ...     CreepDynamics, ElectricVibrationDynamics, PreisachModel, StageModel)
    >>> from piezo_recorder import recording_of
    >>> line = PreisachModel.line(0.0, 10.0, 2.0)
    >>> time_s = 0.01 * np.arange(500)
    >>> voltage_v = 5.0 - 5.0 * np.cos(3.0 * time_s)
    >>> stage, model = (StageModel(line, CreepDynamics(), ElectricVibrationDynamics(lag_s))
    ...                 for lag_s in (0.02, 0.0))
    >>> noise_um = np.random.default_rng(0).normal(0.0, 0.01, 500)
    >>> recording = recording_of({
    ...     "time_s": time_s, "voltage_v": voltage_v,
    ...     "displacement_um": stage.simulate(voltage_v, 0.01) + noise_um})
    >>> step, = decide(model, [recording], play=None, budget=0)    # without a further recording
    >>> step.is_decided, sorted(step.probabilities)
    (False, ['amplifier_lag', 'sensor_lag'])
    """
    known = list(recordings)
    old = old_recordings(model, identified_from or IdentificationRecordings())
    steps: list[DecisionStep] = []
    while True:
        report = part_of(
            progress, len(steps) / (budget + 1), (len(steps) + 1) / (budget + 1))
        diagnosis = diagnose(model, known, holdout, part_of(report, 0.0, DIAGNOSED),
                             identified_from, stated_um, noise, begin_budget())
        before = [alternative.effects for step in steps[-1:]
                  for alternative in step.alternatives.alternatives]
        report("compare the alternatives", DIAGNOSED)
        alternatives = find_alternatives(
            diagnosis.selection.regression, diagnosis.document(), old, before, diagnosis.stated_um)
        decided = decided_verdict(model, known, holdout, diagnosis, alternatives)
        proposal = None
        if not _is_decided(alternatives) and len(steps) < budget:
            proposal = propose(
                alternatives, limits, longest_s, part_of(report, COMPARED, DESIGNED))
        steps.append(DecisionStep(decided, alternatives, proposal))
        if proposal is None:
            return steps
        known.append(play(proposal, part_of(report, DESIGNED, 1.0)))


def _is_decided(alternatives: Alternatives) -> bool:
    return max(alternatives.probabilities.values()) >= SURE
