# SPDX-License-Identifier: BSD-3-Clause
"""Alternative explanations of recordings, each with its parameters and how far these are known."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import logsumexp

from piezo_common.arrays import FloatArray
from piezo_identification.diagnosis.candidates.effect_fit import (
    fit_effects,
    fit_one_more,
    impossible_effects,
)
from piezo_identification.diagnosis.candidates.recording_evidence import recording_evidence
from piezo_identification.diagnosis.comparison.attempts import SAME_AS_OTHER_PARAMETERS
from piezo_identification.diagnosis.comparison.measures_of_fits import (
    distance,
    lack_of_fit,
    mean_square,
)
from piezo_identification.diagnosis.residual.dataset import SPLIT
from piezo_identification.diagnosis.residual.regression import (
    Fit,
    Regression,
    with_fixed_parameters,
)
from piezo_models.effects import Effect, fitted_values, known_effects, with_fitted_values
from piezo_models.effects.outliers import Outliers

NONE = "none"
LEAST_PROBABLE = 0.01
"""Sets of effects that a verdict gives less are no alternatives."""
RESEMBLING = 0.4
"""Part of the misfit that may resemble the difference of two alternatives: set on drawn cases, in
which one with more numbers made up for a quarter of it."""
STEP = 1e-4
"""Change of a fitted number from which its sensitivity is taken, over the number."""


@dataclass(frozen=True, eq=False)
class Alternative:
    """A set of effects as fitted to the recordings so far.

    Attributes
    ----------
    name : str
        Names of the effects joined by +, or "none".
    fit : Fit
    probability : float
        By the recordings so far; those too improbable to be listed have what is missing to one.
    information : (p, p) array
        Root of the information on the model's parameters, in prior widths, and then on the fitted
        numbers of the effects: a change x of them costs |information x|^2 in tolerances.
    """

    name: str
    fit: Fit
    probability: float
    information: FloatArray


@dataclass(frozen=True, eq=False)
class Alternatives:
    """The alternatives, and how errors count when they are compared.

    Attributes
    ----------
    alternatives : tuple of Alternative
        The most probable first.
    regression : Regression
        On the recordings so far.
    variance : float
        Of the errors of the best one in tolerances, times how many neighbouring errors are alike.
    misfit : float
        What the best one leaves beyond the noise, RMS over that of the motion: it may resemble the
        difference of two alternatives, and such a difference decides nothing.
    """

    alternatives: tuple[Alternative, ...]
    regression: Regression
    variance: float
    misfit: float

    @property
    def probabilities(self) -> dict[str, float]:
        """Return the probability of each alternative by its name."""
        return {alternative.name: alternative.probability for alternative in self.alternatives}


def effects_of(verdict: Mapping[str, Any]) -> tuple[Effect, ...]:
    """Return the effects that a verdict found, with their parameters.

    Parameters
    ----------
    verdict : dict
        Content of `verdict.json`.

    Raises
    ------
    ValueError
        If an effect is not known here, or its parameters are not those that it has.
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


def find_alternatives(regression: Regression, verdict: Mapping[str, Any]) -> Alternatives:
    """Fit the explanations that a verdict leaves, and say how probable each is.

    Parameters
    ----------
    regression : Regression
        On the recordings that were diagnosed, weighed beside the effects found.
    verdict : dict
        Content of `verdict.json`.

    Returns
    -------
    Alternatives
    """
    found = effects_of(verdict)
    fits = {_name(found): fit_effects(regression, found) if found else regression.fit(())}
    for fit in (*_undecided(regression, found, verdict), *_probable(regression, found, verdict)):
        if not impossible_effects(fit, regression.dataset.extent):
            fits.setdefault(_name(fit.effects), fit)
    best = min(fits.values(), key=lambda fit: _cost(regression, fit))
    # However little is left, a good model may be wrong by the tolerance.
    variance = max(1.0, mean_square(regression, best)) * max(
        _alike(regression, best, fit) for fit in fits.values())
    chances = _probabilities(
        regression, fits, best, variance, verdict.get("probabilities") or {})
    fits = {name: fit for name, fit in fits.items() if chances[name] >= LEAST_PROBABLE}
    alternatives = [Alternative(name, fit, chances[name], _information(regression, fit))
              for name, fit in fits.items()]
    alternatives.sort(key=lambda alternative: -alternative.probability)
    motion = np.concatenate([
        part.measured_um[rows] - part.measured_um[rows].mean() for part, rows in zip(
            regression.dataset.simulated, regression.dataset.rows, strict=True)])
    misfit = np.sqrt(lack_of_fit(regression, best)
                     / np.mean((motion / regression.tolerance_um)[regression.validation] ** 2))
    return Alternatives(tuple(alternatives), regression, variance, float(misfit))


def _name(effects: Sequence[Effect]) -> str:
    return "+".join(sorted(effect.name for effect in effects)) or NONE


def _undecided(regression: Regression, found: tuple[Effect, ...],
               verdict: Mapping[str, Any]) -> list[Fit]:
    """Fit the effects that are not decidable: in place of one that was found, or as one more."""
    kinds, fits = known_effects(), []
    because = verdict.get("not_decidable_because", {})
    for name in verdict.get("not_decidable", []):
        reason = because.get(name, "")
        places = [number for number, effect in enumerate(found)
                  if reason.endswith(f"from {effect.name}")]
        # Other effects are excluded, or the recordings say nothing of them.
        if name not in kinds or not (places or reason == SAME_AS_OTHER_PARAMETERS):
            continue
        others = (*found[: places[0]], *found[places[0] + 1 :]) if places else found
        # As one more it does what other parameters of the model do: they then stay as they are.
        used = regression if places else with_fixed_parameters(regression, found)
        fit = fit_one_more(used, kinds[name], others, recording_evidence(used, others))
        if fit is not None:
            fits.append(fit_effects(used, fit.effects))
    return fits


def _probable(regression: Regression, found: tuple[Effect, ...],
              verdict: Mapping[str, Any]) -> list[Fit]:
    """Fit the sets of effects to which the verdict gives a probability worth a test."""
    kinds, fits = known_effects(), []
    for name, probability in (verdict.get("probabilities") or {}).items():
        names = [] if name == NONE else name.split("+")
        if probability < LEAST_PROBABLE or any(each not in kinds for each in names):
            continue
        effects = tuple(effect for effect in found if effect.name in names)
        fit: Fit | None = regression.fit(effects)
        for each in names:
            if fit is not None and each not in {effect.name for effect in fit.effects}:
                evidence = recording_evidence(regression, fit.effects)
                fit = fit_one_more(regression, kinds[each], fit.effects, evidence)
        if fit is not None:
            fits.append(fit_effects(regression, fit.effects) if fit.effects else fit)
    return fits


def _alike(regression: Regression, best: Fit, other: Fit) -> float:
    """Return how many errors count as one where two alternatives are compared, at least one."""
    rows = regression.validation
    change, left = (other.residual - best.residual)[rows], best.residual[rows]
    sums = np.bincount(regression.dataset.stretch[rows], left * change)
    alone = float(np.mean(left**2) * np.sum(change**2))
    return max(1.0, float(np.sum(sums**2)) / alone) if alone > 0.0 else 1.0


def _cost(regression: Regression, fit: Fit) -> float:
    """Return the sum of squares on held-out data, and a share of what changed parameters cost."""
    changed = regression.prior @ fit.coefficients
    return float(np.sum(fit.residual[regression.validation] ** 2)
                 + changed @ changed / SPLIT.held_out)


def _probabilities(regression: Regression, fits: Mapping[str, Fit], best: Fit, variance: float,
                   given: Mapping[str, float]) -> dict[str, float]:
    """Return the probabilities that a verdict gives; else those of the errors on held-out data.

    Errors beyond the noise may resemble the difference of two alternatives. What they could make up
    for is subtracted from what speaks for the best.
    """
    if sum(given.get(name, 0.0) for name in fits) > 0.0:
        weights = np.array([max(given.get(name, 0.0), LEAST_PROBABLE**2) for name in fits])
        return dict(zip(fits, (weights / weights.sum()).tolist(), strict=True))
    count = np.count_nonzero(regression.validation)
    left = np.sqrt(lack_of_fit(regression, best))
    logs = []
    for fit in fits.values():
        unsure = 2.0 * RESEMBLING * count * left * distance(regression, best, fit)
        gained = _cost(regression, fit) - _cost(regression, best)
        logs.append(-0.5 * max(0.0, gained - unsure) / variance)
    return dict(zip(fits, np.exp(np.array(logs) - logsumexp(logs)).tolist(), strict=True))


def sensitivities(simulate: Any, effects: tuple[Effect, ...]) -> FloatArray:
    """Return the change of a simulation with each fitted number of some effects.

    Parameters
    ----------
    simulate : callable
        Given effects: an array of shape (N,).
    effects : tuple of Effect

    Returns
    -------
    (N, p) array
    """
    middle, columns = simulate(effects), []
    for number, effect in enumerate(effects):
        values, low, high = fitted_values(effect)
        for index in range(values.size):
            step = STEP * max(1.0, abs(values[index]))
            if values[index] + step > high[index]:
                step = -step
            moved = values.copy()
            moved[index] = max(moved[index] + step, low[index])
            changed = (*effects[:number], with_fitted_values(effect, moved), *effects[number + 1 :])
            columns.append((simulate(changed) - middle) / step)
    return np.column_stack(columns) if columns else np.zeros((middle.size, 0))


def _information(regression: Regression, fit: Fit) -> FloatArray:
    """Root of what the recordings and the prior tell of model's parameters and effects."""
    of_effects = -sensitivities(regression.difference, fit.effects)
    columns = np.hstack([regression.weighted, of_effects])[regression.estimation]
    prior = np.hstack([regression.prior, np.zeros((len(regression.prior), of_effects.shape[1]))])
    root = np.asarray(np.linalg.qr(np.vstack([columns, prior]), mode="r"))
    nuisance = regression.dataset.nuisance_count
    return np.asarray(root[nuisance:, nuisance:])
