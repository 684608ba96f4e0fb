# SPDX-License-Identifier: BSD-3-Clause
"""Alternative explanations of recordings, with their parameters and uncertainties."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_common.cancellation import check_cancelled
from piezo_common.long_matrix import triangle_of
from piezo_common.side_by_side import side_by_side
from piezo_identification.diagnosis.comparison.criteria import Reason
from piezo_identification.diagnosis.joint.alternatives import (
    Alternative,
    Appearance,
    alternative_of,
    continued,
)
from piezo_identification.diagnosis.joint.probabilities import (
    ALTERNATIVE,
    NONE,
    expected_errors,
    label_of,
    listed_probabilities,
)
from piezo_identification.fitting.effect_fit import fit_one_more
from piezo_identification.fitting.joint_fit import JointFit, JointProblem
from piezo_identification.fitting.model_weights import HeldOut
from piezo_identification.fitting.recording_evidence import recording_evidence
from piezo_identification.fitting.regression import Regression, with_fixed_parameters
from piezo_models.effects import Effect, known_effects
from piezo_models.effects.outliers import Outliers
from piezo_recorder.reading.recording import Recording

TURNS = 7
"""Largest number of continued fits of two steps each. With the single one of a diagnosis, a correct
alternative would lose if its model has to change more."""
IDLE = 1e-3
"""Smallest change due to an effect, relative to the tolerance of a row, that makes a difference."""

Effects = tuple[Effect, ...]


@dataclass(frozen=True, eq=False)
class WeighedAlternative(Alternative):
    """A set of effects, estimated with the model on all recordings together."""

    probability: float
    """Probability from the recordings so far; the sum over all listed alternatives is less than one
    by the probability of unlisted ones."""
    information: FloatArray
    """Square root of the information on the model's parameters, in prior widths, followed by the
    fitted parameters of the effects, (p, p): a change x costs ``|information x|^2`` in standard
    deviations."""

    @property
    def name(self) -> str:
        """Return the names of the effects joined by +, or "none"."""
        return self.evidence.label

    @property
    def own(self) -> Effects:
        """Return the effects that the model already had."""
        return self.fit.effects[: len(self.fit.effects) - len(self.names)]

    @property
    def effects(self) -> Effects:
        """Return the effects without those that the model already had."""
        return self.fit.effects[len(self.own) :]


@dataclass(frozen=True, eq=False)
class Alternatives:
    """The alternatives, and the errors to expect in the next recording."""

    alternatives: tuple[WeighedAlternative, ...]
    """Alternatives, the most probable first."""
    problem: JointProblem
    """Problem with the recordings so far and those of the identification."""
    alike: float
    """Number of neighbouring errors that count as one."""
    misfit: float
    """RMS residual of the best one beyond the noise, relative to that of the motion."""

    @property
    def probabilities(self) -> dict[str, float]:
        """Return the probability of each alternative by name."""
        return {alternative.name: alternative.probability for alternative in self.alternatives}


def effects_of(verdict: Mapping[str, Any]) -> tuple[Effect, ...]:
    """Return the effects that a verdict (content of `verdict.json`) found.

    Raise ValueError if an effect is unknown, or its parameters do not match.
    """
    kinds, found = known_effects(), []
    for entry in verdict.get("effects", []):
        name = entry["name"]
        if name not in kinds:
            raise ValueError(f"the verdict names the effect {name}, which is not known here: "
                             "install the package that it comes from")
        if kinds[name] is not Outliers:
            try:
                found.append(kinds[name](**entry["parameters"]))
            except TypeError:
                raise ValueError(f"the verdict's parameters of {name} are not those that it has: "
                                 "diagnose again") from None
    return tuple(found)


def find_alternatives(regression: Regression, verdict: Mapping[str, Any],
                      old: Sequence[Recording] = (), others: Iterable[Effects] = (),
                      stated_um: float = 0.0) -> Alternatives:
    """Fit the explanations that a verdict leaves open, with their probabilities.

    Each is estimated together with the model's parameters, with a prior as wide as the recordings
    of the identification allow: errors of a fixed model would resemble effects.

    The regression on the diagnosed recordings is weighted with the effects found. `old` are the
    recordings of the identification, conditioned as for a diagnosis, and `others` the sets that
    were alternatives before. `stated_um` is the RMS of the known error of the model.
    """
    dataset, found = regression.dataset, effects_of(verdict)
    sets: dict[str, Effects] = {label_of(found): found}
    for effects in (*others, *_undecided(regression, found, verdict),
                    *_probable(regression, found, verdict)):
        sets.setdefault(label_of(effects), effects)
    problem = JointProblem(dataset.model, dataset.recordings, old, len(dataset.recordings),
                           simulated=dataset.simulated)
    was_there = any(entry.get("came") == Appearance.BEFORE
                    for entry in verdict.get("effects", []))
    return _weighed(problem, _fit(problem, sets, was_there), stated_um)


def _fit(problem: JointProblem, sets: Mapping[str, Effects], was_there: bool,
         ) -> dict[str, JointFit]:
    """Fit sets of effects together with the model, and omit the physically impossible ones.

    The first is fitted before the others, whose fits end when they can no longer become the best.
    A superset of it starts from its result. A set that ends behind the best is fitted again from
    the model of the best, because another optimum may be closer. If no set is possible, only the
    model without effects remains.
    """
    found, *others = sets.values()
    first = continued(problem, _fitted(problem, found, was_there), most=TURNS)

    def begins_from_first(effects: Effects) -> bool:
        return {effect.name for effect in found} < {effect.name for effect in effects}

    def fit_of(effects: Effects) -> JointFit:
        begun = first if begins_from_first(effects) else None
        return continued(problem, _fitted(problem, effects, was_there, begun), first, TURNS)

    fitted = [first, *side_by_side(fit_of, others)]
    best = min(fitted, key=lambda fit: fit.against)

    def again(fit: JointFit) -> JointFit:
        effects = fit.effects[len(problem.own):]
        if fit is best or best is first and begins_from_first(effects):
            return fit
        moved = _fitted(problem, effects, was_there, best)
        return min(fit, continued(problem, moved, best, TURNS), key=lambda fit: fit.against)

    fits = dict(zip(sets, side_by_side(again, fitted), strict=True))
    extent = problem.dataset.extent
    possible = {name: fit for name, fit in fits.items()
                if name == NONE or not any(effect.impossible(extent) for effect in fit.effects)}
    if not possible:
        possible = {NONE: continued(problem, _fitted(problem, (), was_there), most=TURNS)}
    return without_idle(possible, len(problem.own))


def without_idle(fits: Mapping[str, JointFit], own: int) -> dict[str, JointFit]:
    """Omit sets in which an effect changes nothing, and which are equal to the set without it.

    The effects of the model itself, of which there are `own`, come first in every fit.
    """
    def is_another(fit: JointFit) -> bool:
        whole = fit.regression.difference(fit.effects)
        for index in range(own, len(fit.effects)):
            rest = fit.effects[:index] + fit.effects[index + 1:]
            if label_of(rest[own:]) in fits and np.allclose(
                    fit.regression.difference(rest), whole, rtol=0.0, atol=IDLE):
                return True
        return False

    return {name: fit for name, fit in fits.items() if not is_another(fit)}


def _weighed(problem: JointProblem, fitted: Mapping[str, JointFit],
             stated_um: float) -> Alternatives:
    """Calculate the probabilities of the fits."""
    compared = [alternative_of(
        [] if name == NONE else name.split("+"), fit, bool(fit.later))
        for name, fit in fitted.items()]
    chances = listed_probabilities([each.evidence for each in compared], expected_errors(
        problem.dataset, problem.noise.noise_um, stated_um)).tolist()
    alternatives = sorted(
        (WeighedAlternative(each.names, each.since, each.fit, each.evidence, chance,
                            _information(each.fit))
         for each, chance in zip(compared, chances, strict=True) if chance >= ALTERNATIVE),
        key=lambda alternative: -alternative.probability)
    return Alternatives(tuple(alternatives), problem,
                        *_errors(problem, alternatives[0].evidence.held_out))


def _errors(problem: JointProblem, residuals: Sequence[HeldOut]) -> tuple[float, float]:
    """Return the number of correlated errors in new recordings, and the residual beyond noise."""
    alike, misfit = 1.0, 0.0
    for part, of_recording, noise_um in zip(
            problem.dataset.simulated[: problem.new_count], residuals, problem.noise.noise_um,
            strict=False):
        square = float(np.mean(of_recording.residual_um**2))
        alike = max(alike, of_recording.residual_um.size / of_recording.independent)
        motion_um = float(np.std(part.measured_um[part.begin :]))
        misfit = max(misfit, np.sqrt(max(0.0, square - noise_um**2)) / motion_um)
    return alike, float(misfit)


def _fitted(problem: JointProblem, effects: Effects, was_there: bool,
            begun: JointFit | None = None) -> JointFit:
    """Fit effects as new since the identification, or as present from the start."""
    later = [effect.name for effect in effects if not (
        was_there and (effect.of_the_stage or effect.recurs))]
    own = problem.own if begun is None else begun.effects[: len(problem.own)]
    return problem.fit((*own, *effects), later, begun)


def _undecided(regression: Regression, found: Effects,
               verdict: Mapping[str, Any]) -> list[Effects]:
    """Guess undecidable effects, as a replacement of one that was found, or in addition."""
    kinds, sets = known_effects(), []
    reasons, confounded_with = (
        verdict.get(key, {}) for key in ("not_decidable_reasons", "not_told_from"))
    for name in verdict.get("not_decidable", []):
        places = [number for number, effect in enumerate(found)
                  if effect.name == confounded_with.get(name)]
        # Other effects are excluded, or the recordings do not show them.
        if name not in kinds or not (
                places or reasons.get(name) == Reason.SAME_AS_OTHER_PARAMETERS):
            continue
        others = (*found[: places[0]], *found[places[0] + 1 :]) if places else found
        # An additional effect imitates a change of model parameters, which are therefore fixed.
        used = regression if places else with_fixed_parameters(regression, found)
        fit = fit_one_more(used, kinds[name], others, recording_evidence(used, others))
        if fit is not None:
            sets.append(fit.effects)
    return sets


def _probable(regression: Regression, found: Effects,
              verdict: Mapping[str, Any]) -> list[Effects]:
    """Guess the sets of effects with a sufficient probability in the verdict."""
    kinds, sets = known_effects(), []
    for name, probability in (verdict.get("probabilities") or {}).items():
        names = [] if name == NONE else name.split("+")
        if probability < ALTERNATIVE or any(each not in kinds for each in names):
            continue
        effects: Effects | None = tuple(effect for effect in found if effect.name in names)
        for each in names:
            if effects is not None and each not in {effect.name for effect in effects}:
                fit = fit_one_more(
                    regression, kinds[each], effects, recording_evidence(regression, effects))
                effects = None if fit is None else fit.effects
        if effects is not None:
            sets.append(effects)
    return sets


def _information(fit: JointFit) -> FloatArray:
    """Square root of the information on model parameters and effects, with the prior."""
    check_cancelled()  # a fit that the end of the time interrupts has no derivatives
    regression, of_effects = fit.regression, fit.columns_of_effects
    assert of_effects is not None
    columns = np.hstack([regression.dataset.regressors, of_effects])[regression.estimation]
    columns /= regression.tolerance_um[regression.estimation, np.newaxis]
    prior = np.hstack([regression.prior, np.zeros((len(regression.prior), of_effects.shape[1]))])
    root = triangle_of(np.vstack([columns, prior]))
    nuisance = regression.dataset.nuisance_count
    return np.asarray(root[nuisance:, nuisance:])
