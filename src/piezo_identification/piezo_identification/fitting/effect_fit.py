# SPDX-License-Identifier: BSD-3-Clause
"""Nonlinear least-squares fits of effects, starting from initial guesses made by the effects."""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares

from piezo_common.arrays import FloatArray
from piezo_common.cancellation import check_cancelled
from piezo_identification.fitting.clustered_covariance import clustered_covariance
from piezo_identification.fitting.regression import Fit, Regression
from piezo_models.effects import Effect, Evidence, Extent, fitted_values, with_fitted_values

MOST_EVALUATIONS = 15
"""Largest number of residual evaluations, without those for the derivatives."""

QUICK_EVALUATIONS = 6
"""The same limit for a fit whose result will be refined by another fit."""

RELATIVE_CHANGE = 1e-5
"""A fit ends when the sum of squares changes by less than this fraction."""

MOST_GUESSES = 3
"""Largest number of initial guesses of one effect that are fitted."""

WORST_GUESS = 1.5
"""Largest sum of squares of a guess that is fitted, as a multiple of that of the best guess."""


def fit_effects(regression: Regression, effects: Sequence[Effect],
                fixed: Sequence[Effect] = (), quick: bool = False) -> Fit:
    """Fit effects by nonlinear least squares on the estimation rows, from initial guesses.

    The fixed effects are not changed; they act before the others. A quick fit uses few evaluations
    of quick simulations; see `SimulatedRecording.simulate`.
    """
    guesses = [fitted_values(effect, regression.dataset.extent) for effect in effects]
    ends = np.cumsum([values.size for values, _, _ in guesses])[:-1]

    def effects_at(vector: FloatArray) -> tuple[Effect, ...]:
        return tuple(map(with_fitted_values, effects, np.split(vector, ends)))

    def remainder(vector: FloatArray) -> FloatArray:
        check_cancelled()
        tried = effects_at(vector)
        return regression.remainder(
            regression.difference((*fixed, *tried), tried if quick else ()))

    vector, low, high = (np.concatenate(parts) for parts in zip(*guesses, strict=True))
    solution = least_squares(
        remainder, np.clip(vector, low, high), bounds=(low, high), x_scale="jac",
        ftol=RELATIVE_CHANGE, max_nfev=QUICK_EVALUATIONS if quick else MOST_EVALUATIONS)
    covariance = clustered_covariance(
        solution.jac, solution.fun, regression.dataset.stretch[regression.estimation])
    found = effects_at(solution.x)
    return regression.fit((*fixed, *found), covariance, found if quick else ())


def fit_one_more(regression: Regression, kind: type[Effect], effects: tuple[Effect, ...],
                 evidence: Sequence[Evidence]) -> Fit | None:
    """Fit one more effect in addition to those found, starting from its best guesses.

    The effects found so far are held fixed. The result is the best guess without refinement if no
    guess reduces the error, and None if there is no guess.
    """
    extent = regression.dataset.extent
    guesses = [_within_bounds(guess, extent) for shown in evidence for guess in kind.starts(shown)]
    if not guesses:
        return None
    costs = []
    for guess in guesses:
        residual = regression.remainder(regression.difference((*effects, guess), (guess,)))
        costs.append(residual @ residual)
    none = regression.remainder(regression.difference(effects))
    promising = [
        guesses[number] for number in np.argsort(costs)
        if costs[number] < none @ none and costs[number] < WORST_GUESS * min(costs)
    ][:MOST_GUESSES]
    if not promising:
        guess = guesses[np.argmin(costs)]
        return regression.fit((*effects, guess), quick=(guess,))
    fits = [fit_effects(regression, (guess,), effects, quick=True) for guess in promising]
    return min(fits, key=lambda fit: np.sum(fit.residual[regression.estimation] ** 2))


def impossible_effects(fit: Fit, extent: Extent) -> dict[str, str]:
    """Return why effects of a fit are physically impossible, by name; empty if none is."""
    reasons = {effect.name: effect.impossible(extent) for effect in fit.effects}
    return {name: reason for name, reason in reasons.items() if reason}


def _within_bounds(effect: Effect, extent: Extent) -> Effect:
    """Clip each parameter of an effect to its physical bounds."""
    return with_fitted_values(effect, fitted_values(effect, extent)[0])
