# SPDX-License-Identifier: BSD-3-Clause
"""Play what distinguishes the alternatives, and diagnose again, until one remains."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from piezo_common.budget import Budget
from piezo_common.progress_part import Progress, part_of
from piezo_identification.diagnosis.comparison.validation import Validation
from piezo_identification.diagnosis.diagnose import (
    Decision,
    Diagnosis,
    ceiling_of,
    conclude,
    condition,
    diagnose,
    hold_to_noise,
)
from piezo_identification.diagnosis.evidence.effect_entries import found_outliers
from piezo_identification.diagnosis.evidence.known_noise import KnownNoise
from piezo_identification.diagnosis.experiment_design.alternative_explanations import (
    Alternatives,
    find_alternatives,
)
from piezo_identification.diagnosis.experiment_design.expected_outcome import SURE
from piezo_identification.diagnosis.experiment_design.propose import LONGEST_S, Proposal, propose
from piezo_identification.diagnosis.joint.alternatives import Appearance
from piezo_identification.diagnosis.joint.competition import (
    Competition,
    probabilities_of_named,
    selection_from,
)
from piezo_identification.diagnosis.joint.identification_recordings import (
    IdentificationRecordings,
    old_recordings,
)
from piezo_identification.diagnosis.joint.probabilities import BELIEVED, SOMETHING_ELSE
from piezo_identification.experiments.stage_limits import USUAL_LIMITS, StageLimits
from piezo_identification.fitting.dataset import simulate_recordings
from piezo_identification.fitting.regression import first_regression, fit_without_effects
from piezo_models.cascade import StageModel
from piezo_models.effects.outliers import Outliers
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
    >>> step, = decide(model, [recording], play=None, budget=0)    # those of `diagnose`
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


def decided_verdict(model: StageModel, recordings: Sequence[Recording], holdout: Recording | None,
                    diagnosis: Diagnosis, alternatives: Alternatives) -> Diagnosis:
    """Return a diagnosis with the most probable alternative and all probabilities."""
    best = alternatives.alternatives[0]
    names = best.names
    unnamed = diagnosis.probabilities.get(SOMETHING_ELSE, 0.0)
    listed = sum(alternatives.probabilities.values())
    if not names and unnamed >= BELIEVED:
        return diagnosis  # nothing on the list decides, and it names what explains a part
    chances = {name: (1.0 - unnamed) * share / listed
               for name, share in alternatives.probabilities.items()} | {SOMETHING_ELSE: unnamed}
    competition = Competition(chances, best)
    alike = competition.indistinguishable()
    found = sorted(entry["name"] for entry in diagnosis.effects if entry["name"] != Outliers.name)
    if list(names) == found:
        decided = diagnosis.confounded_with.keys() - alike.keys()
        return replace(diagnosis.without_undecided(decided), probabilities=chances)
    given = condition(model, recordings, holdout)
    first = first_regression(simulate_recordings(model, given.recordings))
    extended = selection_from(
        replace(diagnosis.selection, regression=first), competition, best)
    selection = replace(
        extended, start=fit_without_effects(extended.regression), indistinguishable=alike)
    validation = Validation(first, given.holdout).for_regression(extended.regression)
    if names and not validation.improves(selection.end):
        return replace(diagnosis, probabilities=chances)
    outliers = found_outliers(selection.regression, selection.end.effects)
    if unnamed >= BELIEVED:
        # The probabilities belong to a fit that is not named here.
        chances = probabilities_of_named(competition, selection.regression, selection.end, ())
    held = hold_to_noise(chances, selection, validation, selection.end, outliers, diagnosis.noise,
                         diagnosis.stated_um)
    decision = Decision(selection.end, outliers, {}, _appearance(alternatives), held)
    diagnosed = conclude(
        model, given, selection, validation, decision, ceiling_of(selection, decision))
    return replace(
        diagnosed, identified_from=diagnosis.identified_from, probabilities=held.probabilities,
        noise=diagnosis.noise, stated_um=diagnosis.stated_um)


def _appearance(alternatives: Alternatives) -> Appearance:
    """Return when the effects of the most probable alternative appeared."""
    problem = alternatives.problem
    if problem.new_count == len(problem.dataset.recordings):
        return Appearance.NOT_ASKED
    later = alternatives.alternatives[0].fit.later
    return Appearance.AFTER if later else Appearance.BEFORE
