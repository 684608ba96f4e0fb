# SPDX-License-Identifier: BSD-3-Clause
"""Selection of effects: one is added at a time as long as the gain on held-out data is certain."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from piezo_common.budget import SEARCH, while_time_lasts
from piezo_common.progress_part import Progress
from piezo_common.side_by_side import side_by_side
from piezo_identification.analysis.error_distortion import excluded_by_distortion
from piezo_identification.diagnosis.comparison.criteria import (
    CRITERIA,
    OTHER_PARAMETERS,
    Reason,
    Undecided,
    alternatives,
    distance,
    is_convincing,
    is_indistinguishable,
    is_noise,
    lack_of_fit,
    mean_square,
    score,
    significance,
    simplest_first,
    visible_part,
)
from piezo_identification.fitting.effect_fit import fit_effects, fit_one_more, impossible_effects
from piezo_identification.fitting.recording_evidence import recording_evidence
from piezo_identification.fitting.regression import (
    Fit,
    Regression,
    fit_without_effects,
    reweighted,
    with_fixed_parameters,
)
from piezo_models.effects import Effect, Evidence, known_effects
from piezo_models.effects.outliers import Outliers


@dataclass(frozen=True, eq=False)
class Attempt:
    """A candidate in one round of the comparison."""

    name: str

    fit: Fit | None
    """None if the data give no initial guess, or cannot show the effect."""
    significance: float = 0.0
    """Significance of the gain on held-out data, in standard deviations."""
    reduction_percent: float = 0.0
    """Reduction of the RMS error on held-out data."""
    size: float = 0.0
    """RMS of the contribution, in tolerances."""
    undecided: Undecided | None = None
    """Why the data could not show the effect; None if they could."""


def try_each(regression: Regression, kinds: Sequence[type[Effect]], current: Fit,
             report: Callable[[str, float], None]) -> list[Attempt]:
    """Try each kind of effect in addition to those of a fit."""
    evidence = recording_evidence(regression, current.effects)
    return side_by_side(
        lambda kind: _attempt(regression, kind, current, evidence), kinds,
        lambda number: report(kinds[number].name, number / len(kinds)))


def _attempt(regression: Regression, kind: type[Effect], current: Fit,
             evidence: Sequence[Evidence]) -> Attempt:
    if not kind.several and any(type(effect) is kind for effect in current.effects):
        return Attempt(kind.name, None)
    unexcited = [kind.lacks_excitation(shown) for shown in evidence]
    if all(unexcited):
        return Attempt(kind.name, None, undecided=Undecided(
            Reason.NOT_EXCITED, str(unexcited[0])))
    fit = fit_one_more(regression, kind, current.effects, evidence)
    if fit is None:
        return Attempt(kind.name, None)
    impossible = impossible_effects(fit, regression.dataset.extent)
    if impossible:
        return Attempt(kind.name, None, undecided=Undecided(
            Reason.IMPOSSIBLE, "; ".join(impossible.values())))
    before, after = mean_square(regression, current), mean_square(regression, fit)
    is_visible = visible_part(regression, current, fit) >= CRITERIA.visible
    return Attempt(
        kind.name, fit, significance(regression, current, fit),
        float(100.0 * (1.0 - np.sqrt(after / before))), distance(regression, current, fit),
        None if is_visible else OTHER_PARAMETERS,
    )


MOST_EFFECTS = 3
"""Largest size of a set: in larger ones, some effects compensate for errors of others."""

STUCK = 0.7
"""Ratio of the lack of fit after and before a round above which the search ends."""

AS_GOOD = 2.0
"""Largest lack of fit of a cause that is equivalent to a change of the model's parameters, relative
to that with free parameters. If it is no larger with fixed parameters, no cause is sought."""


@dataclass(frozen=True, eq=False)
class Selection:
    """Result of the comparison of sets of effects."""

    regression: Regression
    """Regression with the noise and outliers estimated with the effects found."""
    start: Fit
    end: Fit
    """Fits without any effect, and with those found."""
    rounds: list[list[Attempt]]
    """Attempts of each round, the best first."""
    indistinguishable: dict[str, str]
    """Candidates that the data cannot distinguish from a chosen one, and that one."""
    not_shown: dict[str, Undecided]
    """Effects that the data cannot show, and why."""
    alternatives: tuple[Fit, ...] = ()
    """Other sets of the last round with nearly as small a residual as the best, and sets in which
    an effect of the best is replaced by one that the data cannot distinguish from it."""
    parts: tuple[Fit, ...] = ()
    """The best set without some of its effects."""
    interrupted: bool = False
    """True if the comparison was ended by Ctrl-C or the time limit: more effects may be missing,
    and some of those found may not be needed."""

    @property
    def residual_um(self) -> float:
        """Return the RMS residual on the validation set, including noise."""
        return self.regression.residual_um(self.end)


def select_effects(regression: Regression, progress: Progress,
                   share: float = SEARCH) -> Selection:
    """Compare sets of the known effects on held-out data, and select the best.

    Every round adds each candidate to each of the few best sets of the round before, and fits the
    best of the larger sets as a whole. The larger set must be convincingly better than the best
    smaller one. After a share of the time limit, the best result so far is returned.
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
        for turn in range(MOST_EFFECTS):
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
            stuck = lack_of_fit(regression, larger[0]) > STUCK * lack_of_fit(
                regression, best)
            weighed = reweighted(regression, larger[0].effects)
            larger = [weighed.fit(fit.effects, fit.covariance) for fit in larger]
            # Assigned together, so that they are consistent whenever the comparison is interrupted.
            regression, start, best = weighed, fit_without_effects(weighed), larger[0]
            others = larger[1:]
            indistinguishable = like_the_best(regression, larger)
            if stuck or mean_square(regression, best) < 1.0 + CRITERIA.noticeable**2:
                break
            sets = alternatives(regression, larger)
        # Larger sets than the best were not convincing.
        others = [fit for fit in alternatives(regression, [best, *others])[1:]
                  if len(fit.effects) <= len(best.effects)]
        if best.effects:
            # With these weights: likelihoods are comparable only at the optimum of each set.
            best, *others = _once_more(regression, [best, *others])
        parts = _parts(regression, best)
        alike = in_place_of_the_found(regression, kinds, best)
        indistinguishable |= {name: found for name, (found, _) in alike.items()}
        others = _without_repeats([*others, *(fit for _, fit in alike.values())])
        not_shown |= explained_by_parameters(regression, kinds, best)
    if search.was_cut:
        # An incomplete result is better than none.
        return Selection(
            regression, start, best, rounds, indistinguishable, not_shown, interrupted=True)
    return Selection(
        regression, start, best, rounds, indistinguishable, not_shown, tuple(others), parts)


def _share_of(progress: Progress, begun: float, share: float) -> Progress:
    """Report the progress of a part of the rounds."""
    return lambda name, fraction: progress(
        f"effect {int(begun) + 1}: {name}",
        (begun + share * fraction) / MOST_EFFECTS)


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
    """Continue the fits of sets of effects, each as a whole."""
    return side_by_side(
        lambda fit: fit_effects(regression, fit.effects) if fit.effects else fit, fits)


def _without_repeats(fits: Sequence[Fit]) -> list[Fit]:
    """Return the first fit of each set of effects."""
    return list({tuple(sorted(effect.name for effect in fit.effects)): fit
                 for fit in reversed(fits)}.values())[::-1]


def _parts(regression: Regression, best: Fit) -> tuple[Fit, ...]:
    """Fit every non-empty proper subset of the effects of a fit."""
    smaller = [effects for size in range(len(best.effects) - 1, 0, -1)
               for effects in combinations(best.effects, size)]
    return tuple(side_by_side(lambda effects: fit_effects(regression, effects), smaller))


def like_the_best(regression: Regression, fits: Sequence[Fit]) -> dict[str, str]:
    """Return effects of fits that are equivalent to the first, best one, and what they replace."""
    best = fits[0]
    found: dict[str, str] = {}
    names = [effect.name for effect in best.effects]
    for other in fits[1:]:
        if is_indistinguishable(regression, best, other):
            others = [effect.name for effect in other.effects]
            missing = [name for name in names if name not in others]
            found |= {name: missing[0] for name in others if name not in names and missing}
    return found


def in_place_of_the_found(regression: Regression, kinds: Sequence[type[Effect]],
                          best: Fit) -> dict[str, tuple[str, Fit]]:
    """Try to replace the effects found by effects declared as indistinguishable from them.

    Return, by name of each equivalent effect, the effect that it replaces and the fit with it.
    """
    tried = [
        (number, kind) for number, effect in enumerate(best.effects) for kind in kinds
        if kind.is_confounded_with(type(effect))
        and kind.name not in {other.name for other in best.without(number)}]

    def in_place(entry: tuple[int, type[Effect]]) -> Fit | None:
        number, kind = entry
        others = best.without(number)
        fit = fit_one_more(regression, kind, others, recording_evidence(regression, others))
        whole = fit and fit_effects(regression, fit.effects)
        return whole if whole and is_indistinguishable(regression, best, whole) else None

    return {kind.name: (best.effects[number].name, whole)
            for (number, kind), whole in zip(tried, side_by_side(in_place, tried), strict=True)
            if whole}


def explained_by_parameters(regression: Regression, kinds: Sequence[type[Effect]],
                            best: Fit) -> dict[str, Undecided]:
    """Return the effects that alone explain what the model's parameters explain, and why."""
    fixed = with_fixed_parameters(regression, best.effects)
    remaining = max(CRITERIA.noise**2, lack_of_fit(regression, best))
    if lack_of_fit(fixed, fixed.fit(best.effects)) <= AS_GOOD * remaining:
        return {}
    evidence = recording_evidence(fixed, best.effects)
    present = {effect.name for effect in best.effects}

    def does_as_well(kind: type[Effect]) -> bool:
        if kind.name in present or all(map(kind.lacks_excitation, evidence)):
            return False
        fit = fit_one_more(fixed, kind, best.effects, evidence)
        return fit is not None and lack_of_fit(fixed, fit) <= AS_GOOD * remaining

    as_well = side_by_side(does_as_well, kinds)
    return {kind.name: OTHER_PARAMETERS
            for kind, is_enough in zip(kinds, as_well, strict=True) if is_enough}
