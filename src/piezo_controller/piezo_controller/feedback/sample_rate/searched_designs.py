# SPDX-License-Identifier: BSD-3-Clause
"""Alternatives to the method of `design_at_sample_rate`, tuned by direct search.

These are H-infinity synthesis over its weights and constant scalings (D and K at once, as in
`dk_iteration`), the forms of `classical_forms`, and repetitive feedback: all have few parameters.
"""

import warnings
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import control
import numpy as np
from scipy.linalg import LinAlgWarning
from scipy.optimize import minimize

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_controller.feedback.feedback_design import FeedbackController
from piezo_controller.feedback.sample_rate import repetitive
from piezo_controller.feedback.sample_rate.classical_forms import FORMS
from piezo_controller.feedback.sample_rate.demands import Demands
from piezo_controller.feedback.sample_rate.fast_design import (
    METHOD,
    check_modes,
    design_at_sample_rate,
    measured_design,
)
from piezo_controller.feedback.sample_rate.light_mode_problem import (
    UNCERTAINTIES,
    SampleRateWeights,
    light_mode_problem,
)
from piezo_controller.feedback.sample_rate.perturbed_loops import PerturbedLoops, light_mode
from piezo_controller.feedback.synthesis.dk_iteration import scale, tick_frequencies
from piezo_controller.feedback.synthesis.generalised_plant import nominal_hysteresis_gain
from piezo_controller.feedback.synthesis.h_infinity import NoController, close, synthesise
from piezo_controller.feedback.synthesis.structured_singular_value import (
    sampled_response,
    structured_singular_values,
)
from piezo_models.cascade import StageModel

H_INFINITY, REPETITIVE = "h_infinity", "repetitive"
METHODS = (METHOD, H_INFINITY, *FORMS, REPETITIVE)

COARSE = 0.03
"""Relative width to which a norm is bisected; the search needs no more accuracy."""

SLACK = 0.05
VIOLATION = 10.0
"""Cost of a decibel beyond a limit, in decibels of margin; larger than any gain from it."""

NO_CONTROLLER = 1e3

STEPS = (0.05, 0.15, 0.4)
"""Sizes of the steps of the local search, relative to a parameter."""


def design_by(method: str, model: StageModel, demands: Demands, clock_period_s: float = 25e-6,
              effort: float = 1.0) -> FeedbackController:
    """Design a feedback that the stage evaluates at every sample by a method of `METHODS`.

    Parameters
    ----------
    clock_period_s, effort
        See `design_at_sample_rate`.

    Returns
    -------
    FeedbackController
        See `measured_design`; its report also holds the ``numbers`` of the family, and for
        ``h_infinity`` ``gamma`` and ``mu``.

    Raises
    ------
    UnstableLoop, ValueError
        See `design_at_sample_rate`.
    """
    if method == METHOD:
        return design_at_sample_rate(model, demands, clock_period_s, effort)
    check_modes(model)
    loops = demands.loops(model, clock_period_s)
    first_mode_hz = min(model.dynamics.mode_frequencies_rad_per_s) / (2 * np.pi)
    family: _Family
    if method == H_INFINITY:
        family = _HInfinityFamily(model, clock_period_s)
    elif method == REPETITIVE:
        family = _RepetitiveFamily(model, min(demands.disturbance_hz), clock_period_s)
    else:
        family = _ClassicalFamily(model, method, clock_period_s)
    numbers = _search_by_trial(family, loops, demands, first_mode_hz, effort)
    return measured_design(family.controller(numbers), model, demands, loops, method,
                           family.report(numbers))


def _search_by_trial(family: "_Family", loops: PerturbedLoops, demands: Demands,
                     first_mode_hz: float, effort: float) -> FloatArray:
    """Return the parameters with the largest margin that was found."""
    def cost(logarithms: FloatArray) -> float:
        try:
            with warnings.catch_warnings():
                # The noise of a loop close to instability is inaccurate; the search moves away from
                # it.
                warnings.simplefilter("ignore", LinAlgWarning)
                figures = loops.measure(family.controller(np.exp(logarithms)))
        except NoController:
            return NO_CONTROLLER
        margin_db = demands.margin_db(figures, first_mode_hz)
        return VIOLATION * demands.violation_db(figures) - margin_db

    return np.asarray(np.exp(_search(cost, family, effort)))


class _ClassicalFamily:
    """A form of `FORMS`."""

    ANYWHERE, NEARBY, SIMPLEX = 60, 60, 250

    def __init__(self, model: StageModel, method: str, clock_period_s: float) -> None:
        self._model, self._clock_period_s = model, clock_period_s
        self._form = FORMS[method]
        self.start, self.bounds = self._form.start, self._form.bounds

    def controller(self, numbers: FloatArray) -> control.StateSpace:
        """Return the controller for given parameters."""
        return self._form.controller(self._model, numbers, self._clock_period_s)

    def report(self, numbers: FloatArray) -> dict[str, Any]:
        """Return the entries of the report that are specific to this family."""
        return {"numbers": dict(zip(self._form.names, map(float, numbers), strict=True))}


class _RepetitiveFamily:
    """Repetitive feedbacks of the lowest disturbance."""

    ANYWHERE, NEARBY, SIMPLEX = 60, 60, 150
    start, bounds = repetitive.START, repetitive.BOUNDS

    def __init__(self, model: StageModel, frequency_hz: float, clock_period_s: float) -> None:
        self._made = repetitive.Repetitive(model, frequency_hz, clock_period_s)

    def controller(self, numbers: FloatArray) -> control.StateSpace:
        """Return the controller for given parameters."""
        return self._made.controller(numbers)

    def report(self, numbers: FloatArray) -> dict[str, Any]:
        """Return the entries of the report that are specific to this family."""
        return {"numbers": dict(zip(repetitive.NAMES, map(float, numbers), strict=True)),
                "repeats_hz": float(self._made.frequencies_hz[0])}


class _HInfinityFamily:
    """H-infinity controllers over their weights and constant scalings."""

    ANYWHERE, NEARBY, SIMPLEX = 0, 60, 80
    NAMES = ("crossover", "corner", "peak", "control_gain", "roll_off", "noise",
             "gain_uncertainty", "mode_uncertainty", "gain_scaling", "mode_scaling")
    start = (0.67, 0.36, 7.6, 0.66, 13.7, 0.001, 0.22, 0.10, 17.0, 3.9)
    """Frequencies as ratios to that of the light mode."""

    bounds = ((0.3, 10.0), (0.02, 0.6), (1.2, 8.0), (0.5, 8.0), (1.0, 15.0), (1e-4, 0.3),
              (0.05, 0.6), (0.01, 0.5), (0.05, 50.0), (0.05, 50.0))

    def __init__(self, model: StageModel, clock_period_s: float) -> None:
        self._model, self._clock_period_s = model, clock_period_s
        self._mode_hz = (model.dynamics.mode_frequencies_rad_per_s[light_mode(model)]
                         / (2 * np.pi))
        self._gain_um_per_v = nominal_hysteresis_gain(model)

    def _synthesised(self, numbers: FloatArray) -> tuple[
            SampleRateWeights, control.StateSpace, control.StateSpace, float]:
        crossover, corner, peak, control_gain, roll_off, noise, of_gain, of_mode, *scalings = (
            map(float, numbers))
        weights = SampleRateWeights(
            crossover * self._mode_hz, corner * self._mode_hz, peak, control_gain,
            roll_off * self._mode_hz, noise, of_gain, of_mode)
        problem = light_mode_problem(self._model, weights, self._clock_period_s, delay_ticks=0)
        controller, gamma = synthesise(scale(problem, scalings), SLACK, tolerance=COARSE)
        return weights, problem, controller, gamma

    def controller(self, numbers: FloatArray) -> control.StateSpace:
        """Return the controller for given parameters."""
        return self._synthesised(numbers)[2] * (1 / self._gain_um_per_v)

    def report(self, numbers: FloatArray) -> dict[str, Any]:
        """Return the entries of the report that are specific to this family."""
        weights, problem, controller, gamma = self._synthesised(numbers)
        points: ComplexArray = np.exp(
            2j * np.pi * tick_frequencies(self._clock_period_s, 200) * self._clock_period_s)
        mu, _ = structured_singular_values(
            sampled_response(close(problem, controller), points), UNCERTAINTIES)
        return {"numbers": dict(zip(self.NAMES, map(float, numbers), strict=True)),
                "sample_rate_weights": asdict(weights), "gamma": float(gamma),
                "mu": float(mu.max())}


_Family = _ClassicalFamily | _RepetitiveFamily | _HInfinityFamily


def _search(cost: Callable[[FloatArray], float], family: _Family, effort: float) -> FloatArray:
    """Return the logarithms of the best parameters: global search, local search, simplex."""
    rng = np.random.default_rng(0)
    low, high = np.log(family.bounds).T
    best = np.log(family.start)
    least = cost(best)
    anywhere, nearby = round(effort * family.ANYWHERE), round(effort * family.NEARBY)
    for trial in range(anywhere + nearby):
        numbers = (rng.uniform(low, high) if trial < anywhere
                   else best + rng.normal(size=best.size) * rng.choice(STEPS))
        value = cost(np.clip(numbers, low, high))
        if value < least:
            least, best = value, np.clip(numbers, low, high)
    simplex = best + np.vstack([np.zeros(best.size), 0.1 * np.eye(best.size)])
    return minimize(cost, best, method="Nelder-Mead", bounds=list(zip(low, high, strict=True)),
                    options={"initial_simplex": np.clip(simplex, low, high), "adaptive": True,
                             "maxfev": max(10, round(effort * family.SIMPLEX))}).x
