# SPDX-License-Identifier: BSD-3-Clause
"""Alternatives to the method of `design_at_sample_rate`, tuned by direct search.

These are H-infinity synthesis over its weights and constant scalings (D and K at once, as in
`dk_iteration`), the forms of `classical_forms`, and repetitive feedback: all have few parameters.
"""

import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass
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
              effort: float = 1.0, loops: PerturbedLoops | None = None) -> FeedbackController:
    """Design a feedback that the stage evaluates at every sample by a method of `METHODS`.

    For the arguments and errors see `design_at_sample_rate`; `loops` are those of the demands, if
    they exist already. The report of `measured_design` also holds the ``numbers`` of the family,
    and for ``h_infinity`` ``gamma`` and ``mu``.
    """
    if method == METHOD:
        return design_at_sample_rate(model, demands, clock_period_s, effort)
    check_modes(model)
    loops = loops or demands.loops(model, clock_period_s)
    first_mode_hz = min(model.dynamics.mode_frequencies_rad_per_s) / (2 * np.pi)
    family = _family(method, model, min(demands.disturbance_hz), clock_period_s)
    numbers = _search_by_trial(family, loops, demands, first_mode_hz, effort)
    return measured_design(family.controller(numbers), model, demands, loops, method,
                           family.report(numbers))


@dataclass(frozen=True)
class _Family:
    """Controllers with a few positive parameters, and the effort of their search."""

    names: tuple[str, ...]
    start: tuple[float, ...]
    bounds: tuple[tuple[float, float], ...]

    trials: tuple[int, int, int]
    """Controllers that are tried anywhere, near the best one, and by the simplex."""
    controller: Callable[[FloatArray], control.StateSpace]
    own: Callable[[FloatArray], dict[str, Any]] = lambda numbers: {}
    """Returns further entries of the report."""

    def report(self, numbers: FloatArray) -> dict[str, Any]:
        """Return the entries of the report that are specific to this family."""
        return {"numbers": dict(zip(self.names, map(float, numbers), strict=True)),
                **self.own(numbers)}


def _family(method: str, model: StageModel, lowest_hz: float, clock_period_s: float) -> _Family:
    if method == H_INFINITY:
        return _h_infinity_family(model, clock_period_s)
    if method == REPETITIVE:
        made = repetitive.Repetitive(model, lowest_hz, clock_period_s)
        return _Family(
            repetitive.NAMES, repetitive.START, repetitive.BOUNDS, (60, 60, 150), made.controller,
            lambda _: {"repeats_hz": float(made.frequencies_hz[0])})
    form = FORMS[method]
    return _Family(form.names, form.start, form.bounds, (60, 60, 250),
                   lambda numbers: form.controller(model, numbers, clock_period_s))


def _h_infinity_family(model: StageModel, clock_period_s: float) -> _Family:
    """Return H-infinity controllers over their weights and constant scalings.

    Frequencies are ratios to that of the light mode.
    """
    mode_hz = model.dynamics.mode_frequencies_rad_per_s[light_mode(model)] / (2 * np.pi)
    gain_um_per_v = nominal_hysteresis_gain(model)

    def synthesised(numbers: FloatArray) -> tuple[
            SampleRateWeights, control.StateSpace, control.StateSpace, float]:
        crossover, corner, peak, control_gain, roll_off, noise, of_gain, of_mode, *scalings = (
            map(float, numbers))
        weights = SampleRateWeights(
            crossover * mode_hz, corner * mode_hz, peak, control_gain, roll_off * mode_hz, noise,
            of_gain, of_mode)
        problem = light_mode_problem(model, weights, clock_period_s, delay_ticks=0)
        return weights, problem, *synthesise(scale(problem, scalings), SLACK, tolerance=COARSE)

    def own(numbers: FloatArray) -> dict[str, Any]:
        weights, problem, controller, gamma = synthesised(numbers)
        points: ComplexArray = np.exp(
            2j * np.pi * tick_frequencies(clock_period_s, 200) * clock_period_s)
        mu, _ = structured_singular_values(
            sampled_response(close(problem, controller), points), UNCERTAINTIES)
        return {"sample_rate_weights": asdict(weights), "gamma": float(gamma),
                "mu": float(mu.max())}

    return _Family(
        ("crossover", "corner", "peak", "control_gain", "roll_off", "noise", "gain_uncertainty",
         "mode_uncertainty", "gain_scaling", "mode_scaling"),
        (0.67, 0.36, 7.6, 0.66, 13.7, 0.001, 0.22, 0.10, 17.0, 3.9),
        ((0.3, 10.0), (0.02, 0.6), (1.2, 8.0), (0.5, 8.0), (1.0, 15.0), (1e-4, 0.3),
         (0.05, 0.6), (0.01, 0.5), (0.05, 50.0), (0.05, 50.0)),
        (0, 60, 80), lambda numbers: synthesised(numbers)[2] * (1 / gain_um_per_v), own)


def _search_by_trial(family: _Family, loops: PerturbedLoops, demands: Demands,
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


def _search(cost: Callable[[FloatArray], float], family: _Family, effort: float) -> FloatArray:
    """Return the logarithms of the best parameters: global search, local search, simplex."""
    rng = np.random.default_rng(0)
    low, high = np.log(family.bounds).T
    best = np.log(family.start)
    least = cost(best)
    anywhere, nearby, simplex_trials = (round(effort * trials) for trials in family.trials)
    for trial in range(anywhere + nearby):
        numbers = (rng.uniform(low, high) if trial < anywhere
                   else best + rng.normal(size=best.size) * rng.choice(STEPS))
        value = cost(np.clip(numbers, low, high))
        if value < least:
            least, best = value, np.clip(numbers, low, high)
    simplex = best + np.vstack([np.zeros(best.size), 0.1 * np.eye(best.size)])
    return minimize(cost, best, method="Nelder-Mead", bounds=list(zip(low, high, strict=True)),
                    options={"initial_simplex": np.clip(simplex, low, high), "adaptive": True,
                             "maxfev": max(10, simplex_trials)}).x
