# SPDX-License-Identifier: BSD-3-Clause
"""The verdict based on alternatives estimated from all recordings together."""

from collections.abc import Sequence
from dataclasses import replace

from piezo_identification.diagnosis.comparison.validation import Validation
from piezo_identification.diagnosis.diagnose import (
    Decision,
    Diagnosis,
    ceiling_of,
    conclude,
    condition,
    hold_to_noise,
)
from piezo_identification.diagnosis.evidence.found_outliers import found_outliers
from piezo_identification.diagnosis.experiment_design.alternative_explanations import Alternatives
from piezo_identification.diagnosis.joint.alternatives import Alternative as Competitor
from piezo_identification.diagnosis.joint.alternatives import Appearance, evidence_of
from piezo_identification.diagnosis.joint.competition import (
    Competition,
    probabilities_of_named,
    selection_from,
)
from piezo_identification.diagnosis.joint.probabilities import SETTINGS as PROBABILITIES
from piezo_identification.diagnosis.joint.probabilities import SOMETHING_ELSE
from piezo_identification.fitting.dataset import simulate_recordings
from piezo_identification.fitting.regression import (
    first_regression,
    fit_without_effects,
)
from piezo_models.cascade import StageModel
from piezo_models.effects.outliers import Outliers
from piezo_recorder.reading.recording import Recording


def decided_verdict(model: StageModel, recordings: Sequence[Recording], holdout: Recording | None,
                    diagnosis: Diagnosis, alternatives: Alternatives) -> Diagnosis:
    """Return a diagnosis with the most probable alternative and all probabilities."""
    best = alternatives.alternatives[0]
    names = tuple(sorted(effect.name for effect in best.effects))
    unnamed = diagnosis.probabilities.get(SOMETHING_ELSE, 0.0)
    listed = sum(alternatives.probabilities.values())
    if not names and unnamed >= PROBABILITIES.believed:
        return diagnosis  # nothing on the list decides, and it names what explains a part
    chances = {name: (1.0 - unnamed) * share / listed
               for name, share in alternatives.probabilities.items()} | {SOMETHING_ELSE: unnamed}
    competitor = Competitor(names, bool(best.fit.later), best.fit, evidence_of(best.name, best.fit))
    competition = Competition(chances, competitor)
    alike = competition.indistinguishable()
    found = sorted(entry["name"] for entry in diagnosis.effects if entry["name"] != Outliers.name)
    if list(names) == found:
        decided = diagnosis.confounded_with.keys() - alike.keys()
        return replace(diagnosis.without_undecided(decided), probabilities=chances)
    given = condition(model, recordings, holdout)
    first = first_regression(simulate_recordings(model, given.recordings))
    extended = selection_from(
        replace(diagnosis.selection, regression=first), competition, competitor)
    selection = replace(
        extended, start=fit_without_effects(extended.regression), indistinguishable=alike)
    validation = Validation(first, given.holdout).for_regression(extended.regression)
    if names and not validation.improves(selection.end):
        return replace(diagnosis, probabilities=chances)
    outliers = found_outliers(selection.regression, selection.end.effects)
    if unnamed >= PROBABILITIES.believed:
        # The probabilities belong to a fit that is not named here.
        chances = probabilities_of_named(competition, selection.regression, selection.end, ())
    held = hold_to_noise(chances, selection, validation, selection.end, diagnosis.noise,
                         diagnosis.stated_um, finds_nothing=not names and outliers is None)
    chances = held.probabilities
    verdict = "unexplained"
    if chances[SOMETHING_ELSE] < PROBABILITIES.believed:
        verdict = "explained" if names or outliers else "none"
    decision = Decision(verdict, selection.end, outliers, {}, _appearance(alternatives), chances,
                        held.sentence, held.predicted)
    diagnosed = conclude(
        model, given, selection, validation, decision, ceiling_of(selection, decision))
    return replace(
        diagnosed, identified_from=diagnosis.identified_from, probabilities=decision.probabilities,
        noise=diagnosis.noise, stated_um=diagnosis.stated_um)


def _appearance(alternatives: Alternatives) -> Appearance:
    """Return when the effects of the most probable alternative appeared."""
    problem = alternatives.problem
    if problem.new_count == len(problem.dataset.recordings):
        return Appearance.NOT_ASKED
    later = alternatives.alternatives[0].fit.later
    return Appearance.AFTER if later else Appearance.BEFORE
