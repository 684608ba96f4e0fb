# SPDX-License-Identifier: BSD-3-Clause
"""Diagnosis of a model with recordings: what it lacks, and how much the effects found improve it.

`diagnose` reads from top to bottom. Each step uses the results of the steps before: recordings,
conditioned, simulated, residual, candidates, fits, comparison, competition, decision, ceiling,
verdict. The report is written by `piezo_identification.diagnosis.report.diagnosis_results`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from piezo_common.budget import SEARCH, Budget, spending, while_time_lasts
from piezo_common.cancellation import check_cancelled
from piezo_common.progress_part import Progress, part_of
from piezo_identification.diagnosis.comparison.criteria import (
    GUESS,
    Reason,
    Undecided,
    is_noise,
    lack_of_fit,
)
from piezo_identification.diagnosis.comparison.selection import Selection, select_effects
from piezo_identification.diagnosis.comparison.validation import Validation
from piezo_identification.diagnosis.evidence.effect_covariance import with_model_errors
from piezo_identification.diagnosis.evidence.effect_entries import (
    FoundOutliers,
    effect_entries,
    found_outliers,
    left_out,
    with_stand_ins,
)
from piezo_identification.diagnosis.evidence.known_noise import (
    KnownNoise,
    noise_of_residuals,
    noise_sources,
)
from piezo_identification.diagnosis.evidence.recording_faults import (
    WRONG_SIGN,
    RecordingFault,
    without_faults,
)
from piezo_identification.diagnosis.evidence.residual_tests import describe_residual
from piezo_identification.diagnosis.joint.alternatives import Appearance
from piezo_identification.diagnosis.joint.competition import (
    Competition,
    compare_models,
    led_by_the_most_probable,
    probabilities_of_named,
    selection_from,
    with_free_model,
    with_plain_model,
)
from piezo_identification.diagnosis.joint.identification_recordings import (
    IdentificationRecordings,
    digest_of,
    old_recordings,
)
from piezo_identification.diagnosis.joint.probabilities import BELIEVED, SOMETHING_ELSE
from piezo_identification.diagnosis.joint.remainder import (
    HeldToNoise,
    held_to_noise,
    held_to_prediction,
)
from piezo_identification.diagnosis.verdict import Verdict
from piezo_identification.fitting.dataset import simulate_recordings
from piezo_identification.fitting.regression import Fit, Regression, first_regression
from piezo_identification.simulation.past_search import PastSearchSettings
from piezo_models.cascade import StageModel
from piezo_models.effects import known_effects
from piezo_recorder.reading.recording import Recording

if TYPE_CHECKING:
    from piezo_identification.diagnosis.evidence.ceiling import Ceiling


ALONE_UNTIL = 0.5
"""Share of the time limit for the new recordings alone, if there are others."""

IN_THE_IDENTIFICATION = "which effects were there at the identification"
"""What is omitted if time runs out before the recordings of the identification are fitted."""

SHARE_ALONE = 0.4
"""Part of the work for the new recordings alone, if others are fitted as well."""


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Verdict):
    """A verdict with its evidence; the effects come with standard deviations, strongest first."""

    selection: Selection
    """The comparison of effects that led to the verdict."""
    noise: KnownNoise = field(default=KnownNoise(), kw_only=True)
    """Noise with which the remaining error was compared."""
    stated_um: float = field(default=0.0, kw_only=True)
    """RMS of the known error of the model."""


@dataclass(frozen=True)
class Conditioned:
    """Recordings with the sign and the rows of the model, and their outliers marked."""

    recordings: list[Recording]
    """Recordings to diagnose."""
    holdout: Recording | None
    """Recording on which the errors are measured."""
    faults: list[RecordingFault]
    """Faults that were corrected in them."""


@dataclass(frozen=True, eq=False)
class Decision:
    """Decision on the effects that a comparison selected."""

    fit: Fit
    """Fit with the effects that are named."""
    outliers: FoundOutliers | None

    refused: dict[str, Undecided]
    """Effects that the held-out data refuse, and why."""
    appearance: Appearance
    """When the effects appeared, as far as the recordings of the identification show."""
    held: HeldToNoise
    """Comparison of the remaining error with the noise, from which the verdict follows."""

    @property
    def verdict(self) -> str:
        """Return "none", "explained" or "unexplained"."""
        if not self.held.is_explained:
            return "unexplained"
        return "explained" if self.fit.effects or self.outliers else "none"


def diagnose(model: StageModel, recordings: Sequence[Recording],
             holdout: Recording | None = None, progress: Progress | None = None,
             identified_from: IdentificationRecordings | None = None,
             stated_um: float | None = None, noise: KnownNoise | None = None,
             budget: Budget | None = None) -> Diagnosis:
    """Find what a model lacks to explain recordings.

    Parameters
    ----------
    holdout : Recording, optional
        Recording on which the errors before and after are measured; by default they are measured on
        the stretches of the recordings that were not fitted.
    identified_from : IdentificationRecordings, optional
        Available recordings from which the model was identified; by default none.
    stated_um : float, optional
        RMS of the known error of the model; by default estimated from the recordings of the
        identification.
    noise : KnownNoise, optional
        Noise according to the model file, in addition to that of the recordings.
    budget : Budget, optional
        Time limit. When it is reached, or with Ctrl-C, the comparison ends with the best result so
        far.

    Raises
    ------
    ValueError
        If there is no recording, or one cannot be used, or the held-out one is among the others.

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
    >>> diagnose(model, [recording])
    <Diagnosis: explained by ..._lag, ... nm RMS before, ... nm after, ... nm noise>
    """
    known = identified_from or IdentificationRecordings()
    refuse_known_holdout(holdout, recordings, known)
    budget = budget or Budget()
    with spending(budget):
        diagnosis = _diagnosed(
            model, recordings, holdout, progress, known, stated_um, noise, budget)
    return replace(diagnosis, not_tried=budget.sentence())


def _diagnosed(model: StageModel, recordings: Sequence[Recording], holdout: Recording | None,
               progress: Progress | None, known: IdentificationRecordings, stated_um: float | None,
               noise: KnownNoise | None, budget: Budget) -> Diagnosis:
    given = condition(model, recordings, holdout)
    # The time limit ends only the comparison: what was found until then becomes a verdict.
    share = SHARE_ALONE if known.recordings else 1.0
    selection = compare_effects(model, given.recordings, part_of(progress, 0.0, share),
                                ALONE_UNTIL if known.recordings else SEARCH)
    validation = Validation(selection.regression, given.holdout)
    report, competition, old = part_of(progress, share, 1.0), None, list[Recording]()
    with while_time_lasts(IN_THE_IDENTIFICATION):
        check_cancelled()
        old = old_recordings(model, known)
        competition = compare_models(
            model, given.recordings, old, selection, stated_um, report)
    if competition is None:
        competition = compare_models(model, given.recordings, [], selection, stated_um, report)
    selection = replace(selection, interrupted=bool(budget.not_tried))
    selection = led_by_the_most_probable(selection, competition)
    competition = with_free_model(competition, model, given.recordings, selection)
    competition = with_plain_model(
        competition, model, given.recordings, old, selection, report)
    sources = noise_sources([*given.recordings, *filter(None, [given.holdout]), *old])
    noise = (noise or KnownNoise()).including(sources)
    decision, found, believed = decide(selection, validation, competition, noise)
    predictable = ceiling_of(found, decision)
    diagnosis = conclude(model, given, found, believed, decision, predictable)
    return replace(diagnosis, selection=replace(selection, end=found.end), noise=noise,
                   stated_um=competition.stated_um, identified_from=known.document(),
                   probabilities=decision.held.probabilities)


def refuse_known_holdout(holdout: Recording | None, recordings: Sequence[Recording],
                         known: IdentificationRecordings) -> None:
    """Raise ValueError if the held-out recording is also diagnosed, or used in the identification.

    They are compared by SHA-256. The validation recording of an identification is allowed, because
    it was not fitted.
    """
    digest = "" if holdout is None else digest_of(holdout)
    if holdout is None or not digest:
        return
    what = ""
    if digest in map(digest_of, recordings):
        what = "one of the recordings that are diagnosed"
    elif digest in (known.hashes or map(digest_of, known.recordings)):
        what = "one of the recordings that the model was identified from"
    if what:
        raise ValueError(f"{holdout.path} cannot be held out, because it is {what}: hold out a "
                         "recording that no fit has seen, or none")


def condition(model: StageModel, recordings: Sequence[Recording],
              holdout: Recording | None) -> Conditioned:
    """Give the recordings the sign and rows of the model, and mark their outliers.

    Raise ValueError if there is no recording.
    """
    if not recordings:
        raise ValueError("there is no recording to diagnose: give one")
    given = [*recordings, *([] if holdout is None else [holdout])]
    usable, faults = zip(*(without_faults(model, recording) for recording in given), strict=True)
    return Conditioned(
        list(usable[: len(recordings)]), None if holdout is None else usable[-1],
        [fault for found in faults for fault in found])


def compare_effects(model: StageModel, recordings: Sequence[Recording],
                    progress: Progress | None, share: float = SEARCH) -> Selection:
    """Simulate the recordings, and compare the effects that may explain the residual.

    With an incomplete model, the best-fitting past of the hysteresis may only compensate for what
    the model lacks. The comparison is therefore also made without a past, and the better one is
    returned.
    """
    simulated = [simulate_recordings(model, recordings)]
    if any(part.past_v for part in simulated[0].simulated):
        simulated.append(simulate_recordings(model, recordings, past_v=()))
    selections = []
    for number, dataset in enumerate(simulated):
        residual = first_regression(dataset)
        selections.append(
            select_effects(residual, part_of(
                progress, number / len(simulated), (number + 1) / len(simulated)), share))
        if selections[-1].interrupted:
            return selections[-1]
    with_past, plain = selections[0], selections[-1]
    most_um = PastSearchSettings.largest_error_ratio * plain.residual_um
    return with_past if with_past.residual_um < most_um else plain


def decide(selection: Selection, validation: Validation,
           competition: Competition, noise: KnownNoise) -> tuple[Decision, Selection, Validation]:
    """Decide which effects are named, and whether they explain the residual.

    If the most probable model contains an effect that was present at the identification, everything
    is measured relative to that model, including the returned selection and validation.
    """
    best, regression = competition.best, selection.regression
    fit, refused = validation.accepted(selection.end)
    found, believed = selection, validation
    if best is not None and not best.since:
        from_best = selection_from(selection, competition, best)
        validation_of_best = validation.for_regression(from_best.regression)
        # If the most probable model explains nothing, its effects replace those of the new
        # recordings only if it reduces the held-out error. For the same effects, the parameters
        # from the new recordings may be better.
        explains = competition.probabilities[SOMETHING_ELSE] < BELIEVED
        is_better = validation_of_best.rms_um(from_best.end) < validation.rms_um(fit) or (
            competition.is_plain or explains and _names(from_best.end) != _names(fit))
        if is_better and validation_of_best.improves(from_best.end):
            found, believed, fit, refused = from_best, validation_of_best, from_best.end, {}
    outliers = found_outliers(found.regression, fit.effects)
    shares = competition.probabilities
    if refused or best is not None and found is selection:
        # The probabilities of the competition belong to fits that are not named here.
        shares = probabilities_of_named(competition, regression, fit, refused)

    held = hold_to_noise(shares, found, believed, fit, outliers, noise, competition.stated_um)
    most = GUESS * lack_of_fit(regression, selection.start)
    if (not held.is_explained and held.predicted is None
            and lack_of_fit(found.regression, fit) > most):
        found, believed, fit = selection, validation, selection.start
        held = replace(hold_to_noise(
            held.probabilities, found, believed, fit, outliers, noise, competition.stated_um),
            probabilities=held.probabilities)
    if found is selection:
        # The recordings of the identification were not fitted: model errors affect the effects.
        fit = with_model_errors(found.regression, fit)
    appearance = competition.appearance(_names(fit))
    return Decision(fit, outliers, refused, appearance, held), found, believed


def hold_to_noise(shares: Mapping[str, float], found: Selection, believed: Validation, fit: Fit,
                  outliers: FoundOutliers | None, noise: KnownNoise,
                  stated_um: float) -> HeldToNoise:
    """Compare the residual of a fit with the noise, or its predictable part if that is unknown.

    `shares` are probabilities based on the noise that each recording shows itself.
    """
    remainders = believed.remainders(fit)
    known = noise.including(noise_of_residuals(found.regression))
    held = held_to_noise(
        shares, remainders, known, stated_um, finds_nothing=not fit.effects and outliers is None)
    if (not held.is_explained or found.interrupted
            or all(known.is_shown(each.period_s) for each in remainders)):
        return held
    return held_to_prediction(held, _learned(found, fit), remainders, stated_um)


def _names(fit: Fit) -> list[str]:
    return sorted(effect.name for effect in fit.effects)


def ceiling_of(selection: Selection, decision: Decision) -> "Ceiling | None":
    """Return how much of the residual any learner could predict.

    It is None if the residual is compatible with known noise, or the comparison was interrupted.
    """
    if decision.held.predicted is not None:
        return decision.held.predicted
    if selection.interrupted or is_noise(selection.regression, decision.fit):
        return None
    return _learned(selection, decision.fit)


def _learned(selection: Selection, fit: Fit) -> "Ceiling":
    # Importing its library takes a second, and most verdicts do not need it.
    from piezo_identification.diagnosis.evidence.ceiling import ceiling

    return ceiling(selection.regression, fit)


def conclude(model: StageModel, given: Conditioned, selection: Selection, validation: Validation,
             decision: Decision, predictable: "Ceiling | None") -> Diagnosis:
    """Assemble the verdict with its numbers and reasons."""
    regression, fit, outliers = selection.regression, decision.fit, decision.outliers
    effects = with_stand_ins(
        [entry | {"came": decision.appearance} for entry in effect_entries(regression, fit)],
        regression.dataset.extent, decision.held.probabilities)
    # Outliers biased the parameters of a model that was identified with them. If no effect is
    # named, refitted parameters may explain what the given ones do not.
    may_move = outliers or decision.verdict == "none" and not is_noise(
        regression, regression.as_given())
    is_changed = bool(fit.effects or regression.dataset.model is not model
                      or may_move and validation.improves(fit))
    extended = regression.extended_model(fit) if is_changed else model
    if outliers:
        effects.append(outliers.entry(regression, fit))
        extended = replace(extended, effects=(*extended.effects, outliers.effect(regression)))
    effects.sort(key=lambda entry: -entry["error_reduction_percent"])
    before, after, where = validation.errors(fit if is_changed else None)
    undecided = _undecided(selection, decision, effects)
    return Diagnosis(
        verdict=decision.verdict, effects=effects, model=extended,
        before=before, after=after,
        noise_floor_um=float(np.median(regression.noise.noise_um)), holdout=where,
        undecided=undecided,
        confounded_with=_confounded_with(selection, effects),
        left=_description(regression, decision, predictable),
        reversed=[fault.recording for fault in given.faults if fault.name == WRONG_SIGN],
        left_out=[*left_out(regression), *validation.left_out()],
        ceiling=None if predictable is None else asdict(predictable), selection=selection,
        recording_faults=[fault.document() for fault in given.faults],
    )


def _description(regression: Regression, decision: Decision, predictable: "Ceiling | None") -> str:
    """Describe the residual of an unexplained recording, or of one with unknown noise."""
    if decision.verdict != "unexplained":
        return decision.held.sentence if decision.held.predicted is not None else ""
    sentences = [decision.held.sentence, describe_residual(regression, decision.fit)]
    if predictable is not None:
        sentences.append(predictable.sentence())
    return " ".join(sentences)


def _confounded_with(selection: Selection, effects: Sequence[dict[str, Any]]) -> dict[str, str]:
    """Return the effects that the data cannot distinguish from a named effect, and that effect."""
    named = {entry["name"] for entry in effects}
    return {name: found for name, found in selection.indistinguishable.items()
            if name not in named and found in named}


def _undecided(selection: Selection, decision: Decision,
               effects: Sequence[dict[str, Any]]) -> dict[str, Undecided]:
    """Return the effects that are neither named nor excluded, and why."""
    named = {entry["name"] for entry in effects}
    reasons = {name: why for name, why in (selection.not_shown | decision.refused).items()
               if name not in named}
    for name, found in _confounded_with(selection, effects).items():
        reasons[name] = Undecided(
            Reason.LIKE_ANOTHER, f"the data does not distinguish it from {found}")
    kinds = known_effects()
    for found in sorted(named & kinds.keys()):
        for name in kinds[found].same_without_dynamics:
            if name not in named:
                reasons.setdefault(name, Undecided(
                    Reason.LIKE_ANOTHER, f"where it acts at once, it is the same as {found}"))
    return reasons
