# SPDX-License-Identifier: BSD-3-Clause
"""Effects that the data cannot distinguish from those found, or from changed model parameters."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from piezo_common.side_by_side import side_by_side
from piezo_identification.diagnosis.comparison.criteria import (
    CRITERIA,
    is_indistinguishable,
    lack_of_fit,
)
from piezo_identification.fitting.effect_fit import fit_effects, fit_one_more
from piezo_identification.fitting.recording_evidence import recording_evidence
from piezo_identification.fitting.regression import (
    Fit,
    Regression,
    with_fixed_parameters,
)
from piezo_models.effects import Effect


class Reason(StrEnum):
    """Kind of reason, for use by programs; users read the sentence."""

    NOT_EXCITED = "not excited"
    IMPOSSIBLE = "impossible"
    SAME_AS_OTHER_PARAMETERS = "same as other parameters"
    LIKE_ANOTHER = "like another effect"
    WORSE_ON_HELD_OUT = "worse on held-out data"


@dataclass(frozen=True)
class Undecided:
    """A reason with its sentence."""

    reason: Reason

    sentence: str
    """Sentence without its end."""


OTHER_PARAMETERS = Undecided(Reason.SAME_AS_OTHER_PARAMETERS,
                             "here a model with slightly other parameters does the same")


AS_GOOD = 2.0
"""Largest lack of fit of a cause that is equivalent to a change of the model's parameters, relative
to that with free parameters. If it is no larger with fixed parameters, no cause is sought."""


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
