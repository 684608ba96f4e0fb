# SPDX-License-Identifier: BSD-3-Clause
"""From a model and recordings to a verdict: what the model lacks, and how much better it gets.

`diagnose` reads from top to bottom. Each step takes what the steps before have returned:
recordings, conditioned, simulated, residual, candidates, fits, comparison, competition, decision,
ceiling, verdict. The report of it is written by `piezo_identification.diagnosis.report.results`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from piezo_common.budget import SEARCH, Budget, spending, while_time_lasts
from piezo_common.cancellation import check_cancelled
from piezo_common.progress_part import Progress, part_of
from piezo_identification.diagnosis.comparison.criteria import is_noise
from piezo_identification.diagnosis.comparison.measures_of_fits import lack_of_fit
from piezo_identification.diagnosis.comparison.reasons import Reason, Undecided
from piezo_identification.diagnosis.comparison.selection import (
    Selection,
    left_rms_um,
    select_effects,
)
from piezo_identification.diagnosis.comparison.validation import Validation
from piezo_identification.diagnosis.evidence.effect_covariance import with_model_errors
from piezo_identification.diagnosis.evidence.effect_entries import effect_entries
from piezo_identification.diagnosis.evidence.found_outliers import (
    FoundOutliers,
    found_outliers,
    left_out,
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
from piezo_identification.diagnosis.evidence.residual_description import describe_residual
from piezo_identification.diagnosis.evidence.stand_ins import with_stand_ins
from piezo_identification.diagnosis.joint.alternatives import Came
from piezo_identification.diagnosis.joint.competition import (
    Competition,
    beside_alternative,
    compare_models,
    led_by_the_most_probable,
    probabilities_of_named,
    with_free_model,
    with_plain_model,
)
from piezo_identification.diagnosis.joint.identification_recordings import (
    IdentificationRecordings,
    digest_of,
    old_recordings,
)
from piezo_identification.diagnosis.joint.probabilities import SETTINGS as PROBABILITIES
from piezo_identification.diagnosis.joint.probabilities import SOMETHING_ELSE
from piezo_identification.diagnosis.joint.remainder import (
    HeldToNoise,
    held_to_noise,
    held_to_prediction,
)
from piezo_identification.diagnosis.verdict import Verdict
from piezo_identification.fitting.dataset import simulate_recordings
from piezo_identification.fitting.regression import Fit, Regression, first_regression
from piezo_identification.simulation.model_run import PastSearchSettings
from piezo_models.cascade import StageModel
from piezo_models.effects import known_effects
from piezo_recorder.reading.recording import Recording

if TYPE_CHECKING:
    from piezo_identification.diagnosis.evidence.ceiling import Ceiling


@dataclass(frozen=True)
class VerdictSettings:
    """Thresholds of the verdict.

    Attributes
    ----------
    guess : float
        Part of the power of the lack of fit that may be left before the effects found are mere
        guesses.
    """

    guess: float = 0.5


SETTINGS = VerdictSettings()

ALONE_UNTIL = 0.5
"""Share of the time until which the new recordings are looked at alone, where there are others."""

IN_THE_IDENTIFICATION = "which effects were there at the identification"
"""What is left out where the time ends before the recordings of the identification are fitted."""

SHARE_ALONE = 0.4
"""Part of the work for the new recordings alone, where others are asked as well."""


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Verdict):
    """A verdict with its evidence; the effects come with standard deviations, strongest first.

    Attributes
    ----------
    selection : Selection
        The comparison that led to it, for the report.
    noise : KnownNoise
        To which what remains was held.
    stated_um : float
        RMS of what the model is known to be wrong by.
    """

    selection: Selection
    noise: KnownNoise = field(default=KnownNoise(), kw_only=True)
    stated_um: float = field(default=0.0, kw_only=True)


@dataclass(frozen=True)
class Conditioned:
    """Recordings with the sign and the rows of the model, and their outliers marked.

    Attributes
    ----------
    recordings : list of Recording
        To be diagnosed.
    holdout : Recording or None
        On which the errors are measured.
    faults : list of RecordingFault
        That were taken out of them.
    """

    recordings: list[Recording]
    holdout: Recording | None
    faults: list[RecordingFault]

    @property
    def reversed(self) -> list[str]:
        """Return the paths of those whose sign was changed."""
        return [fault.recording for fault in self.faults if fault.name == WRONG_SIGN]


@dataclass(frozen=True, eq=False)
class Decision:
    """What is decided of the effects that a comparison selected.

    Attributes
    ----------
    verdict : str
        "none", "explained" or "unexplained".
    fit : Fit
        With the effects that are named.
    outliers : FoundOutliers or None
    refused : dict of str to Undecided
        Effects that the held-out data refuse, and why.
    came : Came
        When the effects came, as far as the recordings of the identification show.
    probabilities : dict of str to float
        From which the verdict follows.
    remains : str
        How many times the noise what remains is, and what shows the noise.
    predicted : Ceiling or None
        What a learner predicts of what remains; None where it was not asked yet.
    """

    verdict: str
    fit: Fit
    outliers: FoundOutliers | None
    refused: dict[str, Undecided]
    came: Came
    probabilities: dict[str, float]
    remains: str
    predicted: "Ceiling | None" = None


def diagnose(model: StageModel, recordings: Sequence[Recording],
             holdout: Recording | None = None, progress: Progress | None = None,
             identified_from: IdentificationRecordings | None = None,
             stated_um: float | None = None, noise: KnownNoise | None = None,
             budget: Budget | None = None) -> Diagnosis:
    """Find what a model lacks to explain recordings.

    Parameters
    ----------
    holdout : Recording, optional
        On which the errors before and after are measured; by default they are measured on the
        stretches of the recordings that were not fitted.
    progress : callable, optional
        Called with (what is done, fraction).
    identified_from : IdentificationRecordings, optional
        What is at hand of the recordings that the model was identified from; by default nothing.
    stated_um : float, optional
        RMS of what the model is known to be wrong by; by default what the recordings of the
        identification tell.
    noise : KnownNoise, optional
        What the model file tells of the noise; the recordings at hand tell the rest.
    budget : Budget, optional
        Time that the work may take: the comparison then ends with the best that it has found, as
        it does with Ctrl-C.

    Raises
    ------
    ValueError
        If there is no recording, or one cannot be used, or the held-out one is among the others.
    """
    refuse_known_holdout(holdout, recordings, identified_from)
    budget = budget or Budget()
    with spending(budget):
        diagnosis = _diagnosed(model, recordings, holdout, progress,
                               identified_from or IdentificationRecordings(), stated_um, noise,
                               budget)
    return replace(diagnosis, not_tried=budget.sentence())


def _diagnosed(model: StageModel, recordings: Sequence[Recording], holdout: Recording | None,
               progress: Progress | None, known: IdentificationRecordings, stated_um: float | None,
               noise: KnownNoise | None, budget: Budget) -> Diagnosis:
    given = condition(model, recordings, holdout)
    # The end of the time ends the comparison alone: what was found until then becomes a verdict.
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
    noise = (noise or KnownNoise()).beside(sources)
    decision, found, believed = decide(selection, validation, competition, noise)
    predictable = ceiling_of(found, decision)
    told = tell(model, given, found, believed, decision, predictable)
    return replace(told, selection=replace(selection, end=found.end), noise=noise,
                   stated_um=competition.stated_um, identified_from=known.document(),
                   probabilities=decision.probabilities)


def refuse_known_holdout(holdout: Recording | None, recordings: Sequence[Recording],
                         identified_from: IdentificationRecordings | None) -> None:
    """Refuse a held-out recording that is diagnosed, or that the model was identified from.

    Parameters
    ----------
    recordings : sequence of Recording
        That are diagnosed.

    Raises
    ------
    ValueError
        If it has the SHA-256 of one of them; the validation of an identification was not fitted.
    """
    digest = "" if holdout is None else digest_of(holdout)
    if holdout is None or not digest:
        return
    known = identified_from or IdentificationRecordings()
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
    """Give the recordings the sign and the rows of the model, and mark their outliers.

    Raises
    ------
    ValueError
        If there is no recording.
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

    A past of the hysteresis that fits best beside a model that lacks something may be there only to
    make up for it. The comparison is made without any past too, and the better one is returned.

    Parameters
    ----------
    recordings : sequence of Recording
        With the sign of the model, and their outliers marked.
    share : float
        Of the time that the work may take, after which the best until then is returned.
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
    most_um = PastSearchSettings.largest_error_ratio * left_rms_um(plain)
    return with_past if left_rms_um(with_past) < most_um else plain


def decide(selection: Selection, validation: Validation,
           competition: Competition, noise: KnownNoise) -> tuple[Decision, Selection, Validation]:
    """Decide which effects are named, and whether they explain the residual.

    Where the model that is believed has an effect that was there all along, everything is measured
    beside that model.

    Parameters
    ----------
    noise : KnownNoise
        What remains is held to the least of it.

    Returns
    -------
    Decision
    Selection, Validation
        Beside the model that is believed.
    """
    best, regression = competition.best, selection.regression
    fit, refused = validation.accepted(selection.end)
    found, believed = selection, validation
    if best is not None and not best.since:
        beside = beside_alternative(selection, competition, best)
        validation_beside = validation.beside(beside.regression)
        # Where the model that is believed explains nothing, its names are better than those of
        # the new recordings alone only if it leaves less of held-out data; for the same effects
        # the parameters of these may be better.
        explains = competition.probabilities[SOMETHING_ELSE] < PROBABILITIES.believed
        is_better = validation_beside.rms_um(beside.end) < validation.rms_um(fit) or (
            competition.is_plain or explains and _names(beside.end) != _names(fit))
        if is_better and validation_beside.improves(beside.end):
            found, believed, fit, refused = beside, validation_beside, beside.end, {}
    outliers = found_outliers(found.regression, fit.effects)
    shares = competition.probabilities
    if refused or best is not None and found is selection:
        # Those of the competition are of fits that are not named here.
        shares = probabilities_of_named(competition, regression, fit, refused)

    held = hold_to_noise(shares, found, believed, fit, noise, competition.stated_um,
                         finds_nothing=not fit.effects and outliers is None)
    is_explained = held.probabilities[SOMETHING_ELSE] < PROBABILITIES.believed
    most = SETTINGS.guess * lack_of_fit(regression, selection.start)
    if (not is_explained and held.predicted is None
            and lack_of_fit(found.regression, fit) > most):
        found, believed, fit = selection, validation, selection.start
        held = replace(
            hold_to_noise(held.probabilities, found, believed, fit, noise, competition.stated_um,
                          finds_nothing=outliers is None),
            probabilities=held.probabilities)
    verdict = "unexplained"
    if is_explained:
        verdict = "explained" if fit.effects or outliers else "none"
    if found is selection:
        # The recordings of the identification did not take part: its errors are in the effects.
        fit = with_model_errors(found.regression, fit)
    came = competition.came(_names(fit))
    return (Decision(verdict, fit, outliers, refused, came, held.probabilities, held.sentence,
                     held.predicted), found, believed)


def hold_to_noise(shares: Mapping[str, float], found: Selection, believed: Validation, fit: Fit,
                  noise: KnownNoise, stated_um: float, finds_nothing: bool) -> HeldToNoise:
    """Hold what a fit leaves to the noise, and where nothing shows that, to what is predicted.

    Parameters
    ----------
    shares : dict of str to float
        Probabilities by the noise that each recording shows itself.
    found, believed : Selection, Validation
        Beside the model that is believed.
    noise : KnownNoise
        Of the recordings at hand and the model file.
    stated_um : float
        RMS of what the model is known to be wrong by.
    finds_nothing : bool
        No effect is named.
    """
    remainders = believed.remainders(fit)
    known = noise.beside(noise_of_residuals(found.regression))
    held = held_to_noise(shares, remainders, known, stated_um, finds_nothing)
    if (held.probabilities[SOMETHING_ELSE] >= PROBABILITIES.believed or found.interrupted
            or all(known.is_shown(each.period_s) for each in remainders)):
        return held
    return held_to_prediction(held, _learned(found, fit), remainders, stated_um)


def _names(fit: Fit) -> list[str]:
    return sorted(effect.name for effect in fit.effects)


def ceiling_of(selection: Selection, decision: Decision) -> "Ceiling | None":
    """Ask how much of what is left any learner could predict, where it is more than noise.

    Returns
    -------
    Ceiling or None
        None where what is left passes for noise that is known, and where the comparison was
        interrupted.
    """
    if decision.predicted is not None:
        return decision.predicted
    if selection.interrupted or is_noise(selection.regression, decision.fit):
        return None
    return _learned(selection, decision.fit)


def _learned(selection: Selection, fit: Fit) -> "Ceiling":
    # Its library takes a second to import, and most verdicts do not ask.
    from piezo_identification.diagnosis.evidence.ceiling import ceiling

    return ceiling(selection.regression, fit)


def tell(model: StageModel, given: Conditioned, selection: Selection, validation: Validation,
         decision: Decision, predictable: "Ceiling | None") -> Diagnosis:
    """Put the verdict together with its numbers and reasons."""
    regression, fit, outliers = selection.regression, decision.fit, decision.outliers
    effects = with_stand_ins(
        [entry | {"came": decision.came} for entry in effect_entries(regression, fit)],
        regression.dataset.extent, decision.probabilities)
    # Outliers had bent the parameters of a model that was identified with them; and where no effect
    # is named, the parameters may explain what the given ones do not.
    may_move = outliers or decision.verdict == "none" and not is_noise(
        regression, regression.as_given())
    is_changed = bool(fit.effects or regression.dataset.model is not model
                      or may_move and validation.improves(fit))
    extended = regression.extended_model(fit) if is_changed else model
    if outliers:
        effects.append(outliers.entry(regression, fit))
        extended = replace(extended, effects=(*extended.effects, outliers.effect(regression)))
    effects.sort(key=lambda entry: -entry["error_reduction_percent"])
    errors = validation.errors(fit if is_changed else None)
    undecided = _undecided(selection, decision, effects)
    return Diagnosis(
        verdict=decision.verdict, effects=effects, model=extended,
        before=errors.before, after=errors.after,
        noise_floor_um=float(np.median(regression.noise.noise_um)), holdout=errors.where,
        not_decidable={name: why.sentence for name, why in undecided.items()},
        reasons={name: why.reason for name, why in undecided.items()},
        not_told_from=_not_told_from(selection, effects),
        left=_left(regression, decision, predictable),
        reversed=given.reversed, left_out=[*left_out(regression), *validation.left_out()],
        ceiling=None if predictable is None else asdict(predictable), selection=selection,
        recording_faults=[fault.document() for fault in given.faults],
    )


def _left(regression: Regression, decision: Decision, predictable: "Ceiling | None") -> str:
    """Describe what an unexplained recording leaves, or one in which nothing shows the noise."""
    if decision.verdict != "unexplained":
        return decision.remains if decision.predicted is not None else ""
    told = [decision.remains, describe_residual(regression, decision.fit)]
    if predictable is not None:
        told.append(predictable.sentence())
    return " ".join(told)


def _not_told_from(selection: Selection, effects: Sequence[dict[str, Any]]) -> dict[str, str]:
    """Return the effects that the data does not tell from one that is named, and which."""
    named = {entry["name"] for entry in effects}
    return {name: found for name, found in selection.indistinguishable.items()
            if name not in named and found in named}


def _undecided(selection: Selection, decision: Decision,
               effects: Sequence[dict[str, Any]]) -> dict[str, Undecided]:
    """Return the effects that are not named though they are not excluded either, and why."""
    named = {entry["name"] for entry in effects}
    reasons = {name: why for name, why in (selection.not_shown | decision.refused).items()
               if name not in named}
    for name, found in _not_told_from(selection, effects).items():
        reasons[name] = Undecided(
            Reason.LIKE_ANOTHER, f"the data does not tell it from {found}")
    kinds = known_effects()
    for found in sorted(named & kinds.keys()):
        for name in kinds[found].same_without_dynamics:
            if name not in named:
                reasons.setdefault(name, Undecided(
                    Reason.LIKE_ANOTHER, f"where it acts at once, it is the same as {found}"))
    return reasons
