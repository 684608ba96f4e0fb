# SPDX-License-Identifier: BSD-3-Clause
"""Fits of a model with linear effects to a measured frequency response."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from piezo_common.arrays import BoolArray, ComplexArray, FloatArray
from piezo_common.cancellation import check_cancelled
from piezo_identification.estimators.estimate import parameter_deviations
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_identification.fitting.dataset import SPLIT
from piezo_identification.fitting.measured_response import best_gain
from piezo_identification.fitting.regression import SETTINGS as FIT
from piezo_models.cascade import StageModel
from piezo_models.effects import Effect, Extent, fitted_values, with_fitted_values
from piezo_models.linear.dynamics_vector import dynamics_of_vector, dynamics_vector


@dataclass(frozen=True)
class ResponseFitSettings:
    """How a frequency response is split and fitted."""

    block: int = 5
    """Number of neighbouring frequencies in a block, because their errors are correlated."""
    tolerance: float = 0.01
    """Relative accuracy of a good model: smaller errors do not justify an effect."""
    dynamics_width: float = float(np.log(1.02))
    """Largest change of the logarithms of the parameters of the model's dynamics."""
    most_evaluations: int = 20
    """Largest number of residual evaluations in one fit."""
    relative_change: float = 1e-4
    """A fit ends when the sum of squares changes by less than this fraction."""


SETTINGS = ResponseFitSettings()


@dataclass(frozen=True, eq=False)
class ResponseFit:
    """A model with effects fitted to a response, and its residual."""

    changes: FloatArray
    """Changes of the logarithms of the dynamics, (m,)."""
    effects: tuple[Effect, ...]

    residual: ComplexArray
    """Residual of the gain, divided by the tolerance, (N,)."""


class ResponseProblem:
    """A measured response, the frequencies that are fitted, and the validation set.

    Parameters
    ----------
    measured : FrequencyResponse
        Response without a hold and with the sign of the model.

    Attributes
    ----------
    block : (N,) array of int
        Number of the block of each frequency.
    estimation : (N,) array of bool
        Frequencies that are fitted; the others are the validation set.
    noise : float
        Noise of the gain.
    tolerance : (N,) array
        Combined noise and accuracy of a good model.
    mode_range_hz : (float, float)
        Lowest and highest measured frequency: a mode outside them is a guess.
    extent : Extent
        Ranges that bound the parameters of effects.
    """

    def __init__(self, model: StageModel, measured: FrequencyResponse) -> None:
        self.model, self.measured = model, measured
        low_hz, high_hz = measured.frequency_hz.min(), measured.frequency_hz.max()
        self.mode_range_hz = float(low_hz), float(high_hz)
        self.extent = Extent(np.inf, -np.inf, np.inf, 1.0 / low_hz, 0.5 / self.mode_range_hz[1])
        self._dynamics = dynamics_vector(model.dynamics)
        self._free = self._dynamics > 0.0
        self.block = np.arange(measured.frequency_hz.size) // SETTINGS.block
        self.estimation = self.block % SPLIT.held_out != SPLIT.held_out // 2
        # The noise is the deviation from the neighbours on both sides.
        bends = np.abs(np.diff(measured.gain, 2))
        self.noise = float(np.median(bends) / np.sqrt(6.0 * np.log(2.0)))
        self.tolerance = np.hypot(self.noise, SETTINGS.tolerance * np.abs(measured.gain))

    def as_given(self) -> ResponseFit:
        """Return the fit of the given model, in which only the gain is free."""
        return self._fit(np.zeros(np.count_nonzero(self._free)), ())

    def fit_dynamics(self, fit: ResponseFit) -> ResponseFit:
        """Fit the dynamics and the last of the effects, starting from a fit."""
        return self._solve(fit.changes, fit.effects, fit.changes.size)

    def fit_last_effect(self, fit: ResponseFit, effect: Effect) -> ResponseFit:
        """Fit one more effect, with the other effects and the dynamics of a fit held fixed."""
        return self._solve(fit.changes, (*fit.effects, effect), 0)

    def gain(self, fit: ResponseFit) -> ComplexArray:
        """Return the gain of the model of a fit at the measured frequencies, (N,)."""
        return self.measured.gain - fit.residual * self.tolerance

    def extended_model(self, fit: ResponseFit) -> StageModel:
        """Return the model with the effects of a fit and its fitted dynamics."""
        return self._model(fit.changes, fit.effects)

    def _model(self, changes: FloatArray, effects: Sequence[Effect]) -> StageModel:
        vector = self._dynamics.copy()
        vector[self._free] *= np.exp(changes)
        dynamics = dynamics_of_vector(
            vector, len(self.model.dynamics.damping_ratios),
            len(self.model.dynamics.antiresonance_damping_ratios))
        return replace(
            self.model, dynamics=dynamics, effects=(*self.model.effects, *effects))

    def _residual(self, changes: FloatArray, effects: Sequence[Effect]) -> ComplexArray:
        """Return the residual with the best gain, divided by the tolerance, (N,)."""
        check_cancelled()
        response = self._model(changes, effects).small_signal_response(
            self.measured.frequency_hz)
        response, wanted = response / self.tolerance, self.measured.gain / self.tolerance
        return np.asarray(wanted - response * best_gain(
            self.model, response[self.estimation], wanted[self.estimation]))

    def _fit(self, changes: FloatArray, effects: Sequence[Effect]) -> ResponseFit:
        return ResponseFit(changes, tuple(effects), self._residual(changes, effects))

    def _solve(self, changes: FloatArray, effects: tuple[Effect, ...], count: int) -> ResponseFit:
        """Fit the last effect, and the first `count` changes of the dynamics."""
        last = effects[-1:]
        values, low, high = fitted_values(last[0], self.extent) if last else (np.empty(0),) * 3

        def at(vector: FloatArray) -> tuple[FloatArray, tuple[Effect, ...]]:
            changed = vector[:count] if count else changes
            found = (with_fitted_values(last[0], vector[count:]),) if last else ()
            return changed, (*effects[:-1], *found)

        def errors(vector: FloatArray) -> FloatArray:
            residual = self._residual(*at(vector))[self.estimation]
            return np.concatenate([residual.real, residual.imag])

        start = np.concatenate([changes[:count], values])
        if start.size == 0:
            return self._fit(changes, effects)
        low = np.concatenate([np.full(count, -SETTINGS.dynamics_width), low])
        high = np.concatenate([np.full(count, SETTINGS.dynamics_width), high])
        free = np.ones(start.size, dtype=bool)
        while True:
            vector, determined = _least_squares(errors, start, low, high, free)
            if determined.all() or not determined.any():
                return self._fit(*at(vector))
            free[free] = determined


def _least_squares(
    errors: Callable[[FloatArray], FloatArray], start: FloatArray, low: FloatArray,
    high: FloatArray, free: BoolArray,
) -> tuple[FloatArray, BoolArray]:
    """Fit some of the parameters; return all, and which of the fitted ones the data determine.

    Parameters that the data do not determine within their bounds should stay at their start.
    """
    def whole(part: FloatArray) -> FloatArray:
        vector = start.copy()
        vector[free] = part
        return vector

    low, high = low[free], high[free]
    solution = least_squares(
        lambda part: errors(whole(part)), np.clip(start[free], low + 1e-12, high - 1e-12),
        bounds=(low, high), x_scale="jac", ftol=SETTINGS.relative_change,
        max_nfev=SETTINGS.most_evaluations,
    )
    return whole(solution.x), parameter_deviations(solution.jac) < high - low


@dataclass(frozen=True)
class ResponseCriteria:
    """When a further effect is named."""

    significant: float = 3.0
    """Significance required of a gain on held-out blocks, in standard deviations."""
    worthwhile_percent: float = 10.0
    """Smallest reduction of the error on held-out frequencies for which an effect is named."""
    distinguished_percent: float = 5.0
    """Smallest difference of two errors that distinguishes candidates."""
    explained: float = 1.0
    """Largest mean square beyond the tolerance of an explained response."""
    near_noise: float = 3.0
    """Largest residual of an explained response, relative to the noise."""
    most_effects: int = 4
    """Number of kinds of linear effects."""


CRITERIA = ResponseCriteria()


def mean_square(problem: ResponseProblem, fit: ResponseFit,
                part: BoolArray | None = None) -> float:
    """Return the mean square residual in tolerances, by default on the validation set."""
    return float(np.mean(np.abs(fit.residual[~problem.estimation if part is None else part]) ** 2))


def lack_of_fit(problem: ResponseProblem, fit: ResponseFit) -> float:
    """Return the mean square residual beyond the tolerance."""
    return max(0.0, mean_square(problem, fit) - 2.0)


def reduction_percent(problem: ResponseProblem, before: ResponseFit, after: ResponseFit) -> float:
    """Return the reduction of the error on held-out frequencies in percent."""
    squares = [mean_square(problem, fit) for fit in (after, before)]
    return float(100.0 * (1.0 - np.sqrt(squares[0] / squares[1])))


def is_convincing(problem: ResponseProblem, before: ResponseFit, after: ResponseFit) -> bool:
    """Return whether the second fit is better, consistently over the held-out blocks."""
    if reduction_percent(problem, before, after) < CRITERIA.worthwhile_percent:
        return False
    rows, change = ~problem.estimation, before.residual - after.residual

    def blocks(residual: ComplexArray) -> FloatArray:
        sums = np.bincount(problem.block[rows], (residual * change.conj()).real[rows])
        return np.asarray(sums, dtype=float)

    spread = np.sqrt(np.sum(blocks(after.residual) ** 2))
    return bool(np.sum(blocks(before.residual)) > CRITERIA.significant * spread)


def held_out_errors(problem: ResponseProblem, fit: ResponseFit) -> dict[str, float]:
    """Return the errors of the gain on held-out frequencies: `rms_um` and `e_y_percent`."""
    rows = ~problem.estimation
    error = np.linalg.norm((fit.residual * problem.tolerance)[rows])
    return {
        "rms_um": float(error / np.sqrt(np.count_nonzero(rows))),
        "e_y_percent": float(100.0 * error / np.linalg.norm(problem.measured.gain[rows])),
    }


def describe_residual(problem: ResponseProblem, fit: ResponseFit) -> str:
    """Return a sentence on the residual and its frequencies."""
    energy = np.abs(fit.residual) ** 2
    power = np.cumsum(energy) / np.sum(energy)
    frequency_hz = problem.measured.frequency_hz
    low_hz, high_hz = frequency_hz[np.searchsorted(power, [0.1, 0.9])]
    worst = int(np.argmax(energy))
    return (
        f"What remains is {held_out_errors(problem, fit)['rms_um'] / problem.noise:.3g} times the "
        "noise that neighbouring frequencies show. "
        f"The residual is {np.sqrt(np.mean(energy)):.3g} times the tolerance of "
        f"{100 * SETTINGS.tolerance:g} % and the noise, most of it from {low_hz:.3g} to "
        f"{high_hz:.3g} Hz, largest at {frequency_hz[worst]:.4g} Hz."
    )


def is_explained(problem: ResponseProblem, fit: ResponseFit) -> bool:
    """Return whether the residual on held-out frequencies is small enough to be noise.

    For a response without noise, the accuracy of a good model is the limit.
    """
    gain = np.sqrt(np.mean(np.abs(problem.measured.gain[~problem.estimation]) ** 2))
    passing = CRITERIA.near_noise * np.hypot(problem.noise, FIT.model_tolerance * gain)
    return bool(lack_of_fit(problem, fit) <= CRITERIA.explained
                and held_out_errors(problem, fit)["rms_um"] <= passing)
