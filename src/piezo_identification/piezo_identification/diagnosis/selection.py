# SPDX-License-Identifier: BSD-3-Clause
"""Effects add one after another while the gain on held-out data is significant."""

from dataclasses import dataclass

import numpy as np

from piezo_models.effects import known_effects
from piezo_models.effects.outliers import Outliers

NOISE = 0.8
"""Size of what is left beyond the noise, in tolerances, below which it counts as noise."""

OVERWHELMING = 0.36
"""Part below which the mean square on held-out data convinces by itself: where one event, such as a
jump, holds all of the evidence, there is no significance by numbers."""

SIGNIFICANT = 5.0
"""Standard deviations that a gain must have; a dozen candidates try in every round."""

NOTICEABLE = 0.25
"""Size of a contribution, in tolerances, below which no effect is named."""

BESIDE = 0.02
"""The same as a part of all that the model did not explain: an effect is not known any better."""

VISIBLE = 0.1
"""Part of a contribution that a retuned model must leave for it to be seen."""

TWIN = 3.0
"""Standard deviations by which one candidate must beat another to be told from it."""

PENALTY = 10.0
"""Tolerances squared by which a fitted number must lower the sum on held-out data."""

CLEARLY_FEWER = 2
"""Fitted numbers by which a set must be smaller to come before one that is slightly better."""

MOST_EFFECTS = 3

RIVALS = 4
"""Sets of one size that go on, and how many times as much as the best they may leave."""
RIVAL = 1.5

TUNED_FOR = "here a model with slightly other parameters does the same"
MUCH_TUNED, AS_TUNED = 4.0, 2.0
"""What must have been tuned away for other causes to be looked for, and what one may leave instead,
as multiples of the structure's power that tuning leaves."""

PROGRESS = 0.7
"""Part of the structure's power that may be left by a round before the search is given up."""


@dataclass(frozen=True, eq=False)
class Attempt:
    """A candidate in one round of the contest.

    Attributes
    ----------
    name : str
    trial : Trial or None
        None where the data hints at none, or cannot show it.
    significance : float
        Of its gain on held-out data, in standard deviations.
    reduction_percent : float
        Of the RMS error on held-out data.
    size : float
        RMS of its contribution in tolerances.
    remark : str
        Why the data could not show it; empty if it could.
    """

    name: str
    trial: object
    significance: float = 0.0
    reduction_percent: float = 0.0
    size: float = 0.0
    remark: str = ""


@dataclass(frozen=True, eq=False)
class Selection:
    """What the contest ended with.

    Attributes
    ----------
    start, end : Trial
        Without any effect, and with those found.
    rounds : list of list of Attempt
        Each round's, the best first.
    twins : dict of str to str
        Candidates that the data cannot tell from one that was chosen, and that one.
    blind : dict of str to str
        Effects that the data cannot show, and why.
    """

    start: object
    end: object
    rounds: list
    twins: dict
    blind: dict


def select(contest, progress=None):
    """Let sets of the known effects compete.

    Every round adds one more effect to each of the few best sets of the round before, in every way,
    and fits the best of the larger sets as a whole. The larger set must be convincingly better
    than the best smaller one. In the end each effect must be needed beside the others.

    Parameters
    ----------
    contest : Contest
    progress : callable, optional
        Called with (what is done, fraction).

    Returns
    -------
    Selection
    """
    kinds = [kind for kind in known_effects().values() if kind is not Outliers]
    start = best = contest.trial(())
    rounds, twins, blind, beam = [], {}, {}, [best]
    for turn in range(MOST_EFFECTS):
        attempts = []
        for place, current in enumerate(beam):
            report = _share_of(progress, turn + place / len(beam), 1.0 / len(beam))
            attempts += _attempts(contest, kinds, current, report)
        if turn == 0:
            blind = {attempt.name: attempt.remark for attempt in attempts if attempt.remark}
        rounds.append(sorted(attempts[: len(kinds)], key=lambda one: _score(contest, one.trial)))
        if turn == 0 and _is_noise(contest, best):
            break
        grown = _simplest_first(contest, _fitted(contest, attempts))
        if not grown or not _convincing(contest, start, best, grown[0]):
            break
        before, best = contest.structure(best), grown[0]
        stuck = contest.structure(best) > PROGRESS * before
        contest.review(best.effects)
        start = contest.bare()
        grown = [contest.trial(trial.effects, trial.covariance) for trial in grown]
        best = grown[0]
        twins = _twins(contest, grown)
        if stuck or contest.held_out_square(best) < 1.0 + NOTICEABLE**2:
            break
        beam = _rivals(contest, grown)
    best = _needed(contest, start, best)
    blind |= _tuned_for(contest, kinds, best)
    return Selection(start, best, rounds, twins | _near_twins(contest, kinds, best), blind)


def _is_noise(contest, trial):
    """True if a trial leaves so little that the diagnosis takes it for noise."""
    return contest.structure(trial) <= NOISE**2


def _share_of(progress, begun, share):
    """The progress of a part of the rounds."""
    if progress is None:
        return lambda name, fraction: None
    return lambda name, fraction: progress(
        f"effect {int(begun) + 1}: {name}", (begun + share * fraction) / MOST_EFFECTS
    )


def _attempts(contest, kinds, current, report):
    """Each kind as one more effect beside those of a trial."""
    evidences = contest.evidences(current.effects)
    attempts = []
    for number, kind in enumerate(kinds):
        report(kind.name, number / len(kinds))
        attempts.append(_attempt(contest, kind, current, evidences))
    return attempts


def _fitted(contest, attempts):
    """The best of the sets, each fitted as a whole, the best first."""
    tried = {}
    for attempt in sorted(attempts, key=lambda one: _score(contest, one.trial)):
        if attempt.trial is not None:
            names = tuple(sorted(effect.name for effect in attempt.trial.effects))
            tried.setdefault(names, attempt.trial)
    rivals = _rivals(contest, list(tried.values()))
    fitted = [contest.fit_effects(trial.effects) for trial in rivals]
    fitted = [trial for trial in fitted if not contest.impossible(trial)]
    return sorted(fitted, key=lambda trial: _score(contest, trial))


def _rivals(contest, trials):
    """The first of some trials, and of the next those that leave not much more."""
    return [
        trial for trial in trials[:RIVALS]
        if _left(contest, trial) < RIVAL * _left(contest, trials[0])
    ]


def _convincing(contest, start, before, after):
    """True if a trial is better than another both significantly and noticeably."""
    least = max(NOTICEABLE, BESIDE * np.sqrt(contest.held_out_square(start)))
    return (
        (contest.significance(before, after) > SIGNIFICANT
         or contest.held_out_square(after) < OVERWHELMING * contest.held_out_square(before))
        and contest.size(before, after) > least
        and contest.held_out_square(after) < contest.held_out_square(before)
    )


def _left(contest, trial):
    """RMS of what is left beyond the noise on held-out data, in tolerances."""
    return np.sqrt(max(NOTICEABLE**2, contest.structure(trial)))


def _alike(contest, best, other, sure=TWIN):
    """True if the data cannot tell a set of effects from the best one.

    What the best set leaves beyond the noise is how far its prediction can be trusted: sets that
    differ by less cannot be told apart.
    """
    return (contest.size(other, best) < _left(contest, best)
            or contest.significance(other, best) < sure)


def _simplest_first(contest, grown):
    """The sets, but one that is like the best with clearly fewer numbers first.

    What more numbers gain must be as sure as what an effect gains.
    """
    if not grown:
        return grown
    first = min(
        (trial for trial in grown if _alike(contest, grown[0], trial, SIGNIFICANT)),
        key=lambda trial: trial.values,
    )
    if first.values > grown[0].values - CLEARLY_FEWER:
        return grown
    return sorted(grown, key=lambda trial: trial is not first)


def _twins(contest, grown):
    """Effects of other sets that are like the best set, and what they stand for."""
    best, twins = grown[0], {}
    names = [effect.name for effect in best.effects]
    for other in grown[1:]:
        if _alike(contest, best, other):
            others = [effect.name for effect in other.effects]
            missing = [name for name in names if name not in others]
            twins |= {name: missing[0] for name in others if name not in names and missing}
    return twins


def _near_twins(contest, kinds, best):
    """The near twins that do in place of effects what these do, and which they stand for."""
    twins = {}
    for number, effect in enumerate(best.effects):
        others = (*best.effects[:number], *best.effects[number + 1 :])
        present = {other.name for other in others}
        for kind in kinds:
            if kind.is_indistinguishable_from(type(effect)) and kind.name not in present:
                trial = contest.challenge(kind, others, contest.evidences(others))
                if trial and _alike(contest, best, contest.fit_effects(trial.effects)):
                    twins[kind.name] = effect.name
    return twins


def _tuned_for(contest, kinds, best):
    """The effects that explain by themselves what the model's parameters were tuned for, and so."""
    held = contest.untuned(best.effects)
    left = max(NOISE**2, contest.structure(best))
    if held.structure(held.trial(best.effects)) < MUCH_TUNED * left:
        return {}
    evidences = held.evidences(best.effects)
    present, found = {effect.name for effect in best.effects}, {}
    for kind in kinds:
        if kind.name not in present and not all(map(kind.lacks_excitation, evidences)):
            trial = held.challenge(kind, best.effects, evidences)
            if trial and held.structure(trial) <= AS_TUNED * left:
                found[kind.name] = TUNED_FOR
    return found


def _needed(contest, start, best):
    """The set without those effects beside which nothing is worse."""
    for number in range(len(best.effects) - 1, -1, -1):
        others = (*best.effects[:number], *best.effects[number + 1 :])
        if others:
            without = contest.fit_effects(others)
            if not _convincing(contest, start, without, best):
                return _needed(contest, start, without)
    return best


def _attempt(contest, kind, current, evidences):
    if not kind.several and any(type(effect) is kind for effect in current.effects):
        return Attempt(kind.name, None)
    reasons = [kind.lacks_excitation(evidence) for evidence in evidences]
    if all(reasons):
        return Attempt(kind.name, None, remark=reasons[0])
    trial = contest.challenge(kind, current.effects, evidences)
    if trial is None:
        return Attempt(kind.name, None)
    reasons = contest.impossible(trial)
    if reasons:
        return Attempt(kind.name, None, remark="; ".join(reasons.values()))
    before, after = contest.held_out_square(current), contest.held_out_square(trial)
    remark = ""
    if contest.visible(current, trial) < VISIBLE:
        remark = TUNED_FOR
    return Attempt(
        kind.name, trial, contest.significance(current, trial),
        100.0 * (1.0 - np.sqrt(after / before)), contest.size(current, trial), remark,
    )


def _score(contest, trial):
    """Sum of squares on held-out data with a penalty for every fitted number."""
    if trial is None:
        return np.inf
    rows = np.count_nonzero(contest.judge)
    square = contest.held_out_square(trial)
    # Where structure is left, a number must lower the sum in proportion.
    return rows * square + PENALTY * trial.values * max(1.0, square)
