# SPDX-License-Identifier: BSD-3-Clause
"""Selection of effects: one is added after another while the gain on held-out data is sure."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

from piezo_common.budget import SEARCH, while_time_lasts
from piezo_common.progress_part import Progress
from piezo_common.side_by_side import side_by_side
from piezo_identification.analysis.error_distortion import excluded_by_distortion
from piezo_identification.diagnosis.comparison.attempts import Attempt, try_each
from piezo_identification.diagnosis.comparison.criteria import (
    CRITERIA,
    alternatives,
    is_convincing,
    is_noise,
    score,
    simplest_first,
)
from piezo_identification.diagnosis.comparison.measures_of_fits import lack_of_fit, mean_square
from piezo_identification.diagnosis.comparison.reasons import Undecided
from piezo_identification.diagnosis.comparison.undecided import (
    explained_by_parameters,
    in_place_of_the_found,
    like_the_best,
)
from piezo_identification.fitting.effect_fit import fit_effects, impossible_effects
from piezo_identification.fitting.regression import (
    Fit,
    Regression,
    fit_without_effects,
    reweighted,
)
from piezo_models.effects import known_effects
from piezo_models.effects.outliers import Outliers


@dataclass(frozen=True)
class SearchSettings:
    """How long the selection goes on.

    Attributes
    ----------
    most_effects : int
        Of a set: with more, some explain what others left wrong.
    stuck : float
        Part of the lack of fit that a round may leave before the search is given up.
    """

    most_effects: int = 3
    stuck: float = 0.7


SETTINGS = SearchSettings()


@dataclass(frozen=True, eq=False)
class Selection:
    """What the comparison of sets of effects ended with.

    Attributes
    ----------
    regression : Regression
        With the noise and the outliers that show beside the effects found.
    start, end : Fit
        Without any effect, and with those found.
    rounds : list of list of Attempt
        Those of each round, the best first.
    indistinguishable : dict of str to str
        Candidates that the data cannot tell from one that was chosen, and that one.
    not_shown : dict of str to Undecided
        Effects that the data cannot show, and why.
    alternatives : tuple of Fit
        Other sets of the last round that leave not much more than the best, and those with an
        effect in place of one of the best that the data cannot tell from it.
    parts : tuple of Fit
        The best set without some of its effects.
    interrupted : bool
        The comparison was ended by Ctrl-C, or as its time was over: more effects may be missing,
        and those found may not be needed beside each other.
    """

    regression: Regression
    start: Fit
    end: Fit
    rounds: list[list[Attempt]]
    indistinguishable: dict[str, str]
    not_shown: dict[str, Undecided]
    alternatives: tuple[Fit, ...] = ()
    parts: tuple[Fit, ...] = ()
    interrupted: bool = False


def select_effects(regression: Regression, progress: Progress | None = None,
                   share: float = SEARCH) -> Selection:
    """Compare sets of the known effects on held-out data, and select the best.

    Every round adds one more effect to each of the few best sets of the round before, in every way,
    and fits the best of the larger sets as a whole. The larger set must be convincingly better
    than the best smaller one.

    Parameters
    ----------
    progress : callable, optional
        Called with (what is done, fraction).
    share : float
        Of the time that the work may take, after which the best until then is returned.
    """
    kinds = [kind for kind in known_effects().values() if kind is not Outliers]
    excluded = excluded_by_distortion(regression.dataset.simulated, kinds)
    kinds = [kind for kind in kinds if kind.name not in excluded]
    start = best = regression.fit(())
    rounds: list[list[Attempt]] = []
    indistinguishable: dict[str, str] = {}
    not_shown: dict[str, Undecided] = {}
    sets = [best]
    others: Sequence[Fit] = ()
    with while_time_lasts("further effects of the new recordings", share) as search:
        for turn in range(SETTINGS.most_effects):
            attempts: list[Attempt] = []
            for number, current in enumerate(sets):
                report = _share_of(progress, turn + number / len(sets), 1.0 / len(sets))
                attempts += try_each(regression, kinds, current, report)
            if turn == 0:
                not_shown = {attempt.name: attempt.undecided for attempt in attempts
                             if attempt.undecided}
            rounds.append(_best_first(regression, attempts[: len(kinds)]))
            if turn == 0 and is_noise(regression, best):
                break
            larger = simplest_first(regression, _fitted_as_a_whole(regression, attempts))
            if not larger or not is_convincing(regression, start, best, larger[0]):
                break
            stuck = lack_of_fit(regression, larger[0]) > SETTINGS.stuck * lack_of_fit(
                regression, best)
            weighed = reweighted(regression, larger[0].effects)
            larger = [weighed.fit(fit.effects, fit.covariance) for fit in larger]
            # Together, so that they fit to each other whenever the comparison is interrupted.
            regression, start, best = weighed, fit_without_effects(weighed), larger[0]
            others = larger[1:]
            indistinguishable = like_the_best(regression, larger)
            if stuck or mean_square(regression, best) < 1.0 + CRITERIA.noticeable**2:
                break
            sets = alternatives(regression, larger)
        # Larger sets than the best did not convince.
        others = [fit for fit in alternatives(regression, [best, *others])[1:]
                  if len(fit.effects) <= len(best.effects)]
        if best.effects:
            # With these weights: only at its optimum is one set likelier than another.
            best, *others = _once_more(regression, [best, *others])
        parts = _parts(regression, best)
        alike = in_place_of_the_found(regression, kinds, best)
        indistinguishable |= {name: found for name, (found, _) in alike.items()}
        others = _without_repeats([*others, *(fit for _, fit in alike.values())])
        not_shown |= explained_by_parameters(regression, kinds, best)
    if search.was_cut:
        # What was found until then is worth more than nothing.
        return Selection(
            regression, start, best, rounds, indistinguishable, not_shown, interrupted=True)
    return Selection(
        regression, start, best, rounds, indistinguishable, not_shown, tuple(others), parts)


def left_rms_um(selection: Selection) -> float:
    """Return the RMS of what a selection leaves on the validation set, noise and all."""
    return selection.regression.left_um(selection.end)


def _share_of(progress: Progress | None, begun: float, share: float) -> Progress:
    """Report the progress of a part of the rounds."""
    if progress is None:
        return lambda name, fraction: None
    return lambda name, fraction: progress(
        f"effect {int(begun) + 1}: {name}",
        (begun + share * fraction) / SETTINGS.most_effects)


def _best_first(regression: Regression, attempts: Sequence[Attempt]) -> list[Attempt]:
    return sorted(attempts, key=lambda attempt: score(regression, attempt.fit))


def _fitted_as_a_whole(regression: Regression, attempts: Sequence[Attempt]) -> list[Fit]:
    """Fit the best of the sets, each as a whole, and return the best first."""
    tried: dict[tuple[str, ...], Fit] = {}
    for attempt in _best_first(regression, attempts):
        if attempt.fit is not None:
            names = tuple(sorted(effect.name for effect in attempt.fit.effects))
            tried.setdefault(names, attempt.fit)
    fits = side_by_side(lambda fit: fit_effects(regression, fit.effects),
                        alternatives(regression, list(tried.values())))
    fits = [fit for fit in fits if not impossible_effects(fit, regression.dataset.extent)]
    return sorted(fits, key=lambda fit: score(regression, fit))


def _once_more(regression: Regression, fits: Sequence[Fit]) -> list[Fit]:
    """Fit sets of effects further, each as a whole."""
    return side_by_side(
        lambda fit: fit_effects(regression, fit.effects) if fit.effects else fit, fits)


def _without_repeats(fits: Sequence[Fit]) -> list[Fit]:
    """Return the first fit of each set of effects."""
    return list({tuple(sorted(effect.name for effect in fit.effects)): fit
                 for fit in reversed(fits)}.values())[::-1]


def _parts(regression: Regression, best: Fit) -> tuple[Fit, ...]:
    """Fit every smaller set of the effects of a fit, but none."""
    smaller = [effects for size in range(len(best.effects) - 1, 0, -1)
               for effects in combinations(best.effects, size)]
    return tuple(side_by_side(lambda effects: fit_effects(regression, effects), smaller))
