# SPDX-License-Identifier: BSD-3-Clause
"""Effects add one after another while the gain on held-out data is significant."""

from dataclasses import dataclass

import numpy as np

from piezo_models.effects import known_effects
from piezo_models.effects.outliers import Outliers

SIGNIFICANT = 5.0
"""Standard deviations that a gain must have; a dozen candidates try in every round."""

NOTICEABLE = 0.25
"""Size of a contribution, in tolerances, below which no effect is named."""

BESIDE = 0.02
"""The same as a part of all that the model did not explain: an effect is not known any better."""

TWIN = 3.0
"""Standard deviations by which one candidate must beat another to be told from it."""

PENALTY = 10.0
"""Tolerances squared by which a fitted number must lower the sum on held-out data."""

MOST_EFFECTS = 4


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
        Why it was not tried; empty if it was.
    """

    name: str
    trial: object
    significance: float = 0.0
    reduction_percent: float = 0.0
    size: float = 0.0
    remark: str = ""

    def convincing(self, least):
        """True if it is both significant and as large as the least that is noticeable."""
        return (self.significance > SIGNIFICANT and self.size > least
                and self.reduction_percent > 0.0)


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
    """Let the known effects compete.

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
    start = current = contest.trial(())
    rounds, twins, blind = [], {}, {}
    for turn in range(MOST_EFFECTS):
        evidences = [
            contest.evidence(index, current.effects) for index in range(len(contest.prepared))
        ]
        attempts = []
        for number, kind in enumerate(kinds):
            if progress is not None:
                progress(f"effect {turn + 1}: {kind.name}",
                         (turn + number / len(kinds)) / MOST_EFFECTS)
            attempts.append(_attempt(contest, kind, current, evidences))
        if turn == 0:
            blind = {attempt.name: attempt.remark for attempt in attempts if attempt.remark}
        attempts.sort(key=lambda attempt: _score(contest, attempt))
        rounds.append(attempts)
        least = max(NOTICEABLE, BESIDE * np.sqrt(contest.held_out_square(start)))
        convincing = [attempt for attempt in attempts if attempt.convincing(least)]
        if not convincing:
            break
        best = convincing[0]
        for other in convincing[1:]:
            if contest.significance(other.trial, best.trial) < TWIN:
                twins[other.name] = best.name
        current = contest.fit_effects(best.trial.effects)
        contest.review(current.effects)
        start, current = contest.trial(()), contest.trial(current.effects, current.covariance)
        if contest.held_out_square(current) < 1.0 + NOTICEABLE**2:
            break
    return Selection(start, current, rounds, twins, blind)


def _attempt(contest, kind, current, evidences):
    if not kind.several and any(type(effect) is kind for effect in current.effects):
        return Attempt(kind.name, None)
    reasons = [kind.lacks_excitation(evidence) for evidence in evidences]
    if all(reasons):
        return Attempt(kind.name, None, remark=reasons[0])
    trial = contest.challenge(kind, current.effects, evidences)
    if trial is None:
        return Attempt(kind.name, None)
    before, after = contest.held_out_square(current), contest.held_out_square(trial)
    return Attempt(
        kind.name, trial, contest.significance(current, trial),
        100.0 * (1.0 - np.sqrt(after / before)), contest.size(current, trial),
    )


def _score(contest, attempt):
    """Sum of squares on held-out data with a penalty for every fitted number."""
    if attempt.trial is None:
        return np.inf
    rows = np.count_nonzero(contest.judge)
    square = contest.held_out_square(attempt.trial)
    # Where structure is left, a number must lower the sum in proportion.
    return rows * square + PENALTY * attempt.trial.values * max(1.0, square)
