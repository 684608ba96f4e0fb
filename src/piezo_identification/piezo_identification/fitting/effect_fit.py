# SPDX-License-Identifier: BSD-3-Clause
"""Nonlinear least-squares fits of effects, from guesses that the effects make themselves."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from piezo_common.arrays import FloatArray
from piezo_common.cancellation import check_cancelled
from piezo_identification.fitting.clustered_covariance import clustered_covariance
from piezo_identification.fitting.regression import Fit, Regression
from piezo_models.effects import Effect, Evidence, Extent, fitted_values, with_fitted_values


@dataclass(frozen=True)
class FitSettings:
    """How far the effects are fitted.

    Attributes
    ----------
    evaluations : int
        Most evaluations of the residual, beside those for its derivatives.
    quick_evaluations : int
        The same of a fit whose result will be fitted once more.
    relative_change : float
        Of the sum of squares, below which a fit ends.
    guesses : int
        Guesses of one effect from which a fit begins.
    worst_guess : float
        What a guess may leave at most, as a multiple of what the best guess leaves.
    """

    evaluations: int = 15
    quick_evaluations: int = 6
    relative_change: float = 1e-5
    guesses: int = 3
    worst_guess: float = 1.5


SETTINGS = FitSettings()


def fit_effects(regression: Regression, effects: Sequence[Effect],
                fixed: Sequence[Effect] = (), quick: bool = False) -> Fit:
    """Fit effects by nonlinear least squares on the estimation rows.

    Parameters
    ----------
    effects : sequence of piezo_models.effects.effect.Effect
        To begin from.
    fixed : sequence of piezo_models.effects.effect.Effect
        Kept as they are, before the others.
    quick : bool
        Fit with few evaluations of quick simulations; see `SimulatedRecording.simulate`.
    """
    guesses = [fitted_values(effect, regression.dataset.extent) for effect in effects]
    sizes = np.cumsum([0, *(values.size for values, _, _ in guesses)])

    def effects_at(vector: FloatArray) -> tuple[Effect, ...]:
        return tuple(
            with_fitted_values(effect, vector[start:end])
            for effect, start, end in zip(effects, sizes[:-1], sizes[1:], strict=True)
        )

    def remainder(vector: FloatArray) -> FloatArray:
        check_cancelled()
        tried = effects_at(vector)
        return regression.remainder(
            regression.difference((*fixed, *tried), tried if quick else ()))

    vector, low, high = (np.concatenate(parts) for parts in zip(*guesses, strict=True))
    solution = least_squares(
        remainder, np.clip(vector, low, high), bounds=(low, high), x_scale="jac",
        ftol=SETTINGS.relative_change,
        max_nfev=SETTINGS.quick_evaluations if quick else SETTINGS.evaluations,
    )
    covariance = clustered_covariance(
        solution.jac, solution.fun, regression.dataset.stretch[regression.estimation])
    found = effects_at(solution.x)
    return regression.fit((*fixed, *found), covariance, found if quick else ())


def fit_one_more(regression: Regression, kind: type[Effect], effects: tuple[Effect, ...],
                 evidence: Sequence[Evidence]) -> Fit | None:
    """Fit one more effect beside those found, from the best of its guesses.

    Parameters
    ----------
    kind : type
        Of the effect.
    effects : tuple of piezo_models.effects.effect.Effect
        Those found.
    evidence : sequence of Evidence
        One for each recording, beside those found.

    Returns
    -------
    Fit or None
        As guessed if no guess is better than nothing; None without any guess.
    """
    extent = regression.dataset.extent
    guesses = [_within_bounds(guess, extent) for shown in evidence for guess in kind.starts(shown)]
    if not guesses:
        return None
    costs = []
    for guess in guesses:
        left = regression.remainder(regression.difference((*effects, guess), (guess,)))
        costs.append(left @ left)
    none = regression.remainder(regression.difference(effects))
    promising = [
        guesses[number] for number in np.argsort(costs)
        if costs[number] < none @ none and costs[number] < SETTINGS.worst_guess * min(costs)
    ][:SETTINGS.guesses]
    if not promising:
        guess = guesses[np.argmin(costs)]
        return regression.fit((*effects, guess), quick=(guess,))
    fits = [fit_effects(regression, (guess,), effects, quick=True) for guess in promising]
    return min(fits, key=lambda fit: np.sum(fit.residual[regression.estimation] ** 2))


def impossible_effects(fit: Fit, extent: Extent) -> dict[str, str]:
    """Return why no stage can have the effects of a fit, by their names; empty if one can."""
    reasons = {effect.name: effect.impossible(extent) for effect in fit.effects}
    return {name: reason for name, reason in reasons.items() if reason}


def _within_bounds(effect: Effect, extent: Extent) -> Effect:
    """Move the parameters of an effect to what is physically possible, each by itself."""
    return with_fitted_values(effect, fitted_values(effect, extent)[0])
