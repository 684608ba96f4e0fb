# SPDX-License-Identifier: BSD-3-Clause
"""Design of a feedback at the sample clock's rate, with a bandwidth beyond the first mode.

Every method is a family of controllers of few numbers, and every family is searched in the same
way: for the largest margin to the demands among the controllers that are equally robust. The
families are the H-infinity synthesis over its weights and constant scalings (D and K at once, as
`dk_iteration` has it), and the classical forms of `classical_candidates`.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import control
import numpy as np
from scipy.optimize import minimize

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_controller.feedback.feedback_design import (
    FeedbackController,
    UnstableLoop,
    feedback_from_control,
)
from piezo_controller.feedback.sample_rate.classical_candidates import CANDIDATES
from piezo_controller.feedback.sample_rate.light_mode_problem import (
    UNCERTAINTIES,
    SampleRateWeights,
    light_mode_problem,
)
from piezo_controller.feedback.sample_rate.perturbed_loops import (
    LoopFigures,
    ModelErrors,
    PerturbedLoops,
    light_mode,
)
from piezo_controller.feedback.synthesis.dk_iteration import scale, tick_frequencies
from piezo_controller.feedback.synthesis.generalised_plant import hysteresis_gain_range
from piezo_controller.feedback.synthesis.h_infinity import NoController, close, synthesise
from piezo_controller.feedback.synthesis.structured_singular_value import (
    sampled_response,
    structured_singular_values,
)
from piezo_models.cascade import StageModel

H_INFINITY = "h_infinity"
METHODS = (H_INFINITY, *CANDIDATES)

COARSE = 0.03
"""Relative width to which a norm is bisected; the search needs no more."""

SLACK = 0.05
VIOLATION = 3.0
"""What a decibel beyond a limit costs, in decibels of margin."""

NO_CONTROLLER = 1e3

STEPS = (0.05, 0.15, 0.4)
"""Sizes of the steps nearby, as parts of a number."""


@dataclass(frozen=True)
class Demands:
    """What a loop is to reach, and what bounds it.

    Attributes
    ----------
    bandwidth_ratio : float
        Of the closed loop at -3 dB to the frequency of the first mode.
    disturbance_hz, attenuation_db : tuple of float
    sensor_noise_um : float
        White at the sample clock's rate, root mean square.
    added_noise_um : float
        Largest displacement that it may cause.
    noise_voltage_v : float
        Largest voltage that it may cause: six of them are within the feedback's usual room of 20 V.
    worst_peak_sensitivity : float
        Largest peak over all stages: the robustness at which designs are compared.
    errors : ModelErrors
    """

    bandwidth_ratio: float = 1.2
    disturbance_hz: tuple[float, ...] = (50.0, 100.0)
    attenuation_db: tuple[float, ...] = (30.0, 20.0)
    sensor_noise_um: float = 0.009
    added_noise_um: float = 0.009
    noise_voltage_v: float = 3.3
    worst_peak_sensitivity: float = 4.0
    errors: ModelErrors = ModelErrors()

    def margin_db(self, figures: LoopFigures, first_mode_hz: float) -> float:
        """Return by how much the least margin exceeds what is asked; negative if it does not."""
        bandwidth_db = _decibels(figures.bandwidth_hz / (self.bandwidth_ratio * first_mode_hz))
        return min(bandwidth_db, *(reached - asked for reached, asked in zip(
            figures.attenuation_db, self.attenuation_db, strict=True)))

    def violation_db(self, figures: LoopFigures) -> float:
        """Return by how much the bounds are exceeded; 0 if they are kept."""
        if figures.unstable:
            return 40.0 + figures.unstable + 1e3 * (figures.largest_pole - 1.0)
        noise_um = self.sensor_noise_um
        return sum(max(0.0, _decibels(value)) for value in (
            figures.worst_peak_sensitivity / self.worst_peak_sensitivity,
            noise_um * figures.noise_gain / self.added_noise_um,
            noise_um * figures.noise_gain_v_per_um / self.noise_voltage_v))


def design_at_sample_rate(model: StageModel, demands: Demands | None = None,
                          method: str = "inverse_pi", clock_period_s: float = 25e-6,
                          model_sha256: str = "", effort: float = 1.0,
                          seed: int = 0) -> FeedbackController:
    """Design a feedback that answers every sample, two samples after it was taken.

    Parameters
    ----------
    model : piezo_models.cascade.StageModel
        With a mode, and no antiresonance.
    demands : Demands, optional
    method : str
        One of `METHODS`; by default the one that reached most where all were compared.
    clock_period_s : float
    model_sha256 : str
        Hash of the model's file, kept with the controller.
    effort : float
        Multiplies the number of controllers that are tried.
    seed : int
        Of the search.

    Returns
    -------
    FeedbackController
        Of period `clock_period_s`. Beside what `feedback_from_control` reports, its report holds
        ``demands``, ``figures`` (`LoopFigures`), ``margin_db``, ``added_noise_um``,
        ``noise_voltage_v``, ``numbers`` of the family, and for ``h_infinity`` ``gamma`` and ``mu``.

    Raises
    ------
    UnstableLoop
        No controller of the family is stable with every stage.
    ValueError
        `method` is unknown, or the model has no mode or has antiresonances.
    """
    if method not in METHODS:
        raise ValueError(f"unknown method {method!r} of the feedback at the sample rate: use one "
                         f"of {', '.join(METHODS)}")
    if not model.dynamics.damping_ratios or model.dynamics.antiresonance_damping_ratios:
        raise ValueError("the model has no mode, or has antiresonances: a feedback at the sample "
                         "rate is designed for modes without them")
    demands = demands or Demands()
    loops = PerturbedLoops(model, demands.errors, clock_period_s, demands.disturbance_hz)
    first_mode_hz = min(model.dynamics.mode_frequencies_rad_per_s) / (2 * np.pi)
    family = (_HInfinityFamily(model, clock_period_s) if method == H_INFINITY
              else _ClassicalFamily(model, method, clock_period_s))

    def cost(logarithms: FloatArray) -> float:
        try:
            figures = loops.measure(family.controller(np.exp(logarithms)))
        except NoController:
            return NO_CONTROLLER
        margin_db = demands.margin_db(figures, first_mode_hz)
        return VIOLATION * demands.violation_db(figures) - margin_db

    numbers = np.exp(_search(cost, family, effort, seed))
    controller = family.controller(numbers)
    figures = loops.measure(controller)
    if figures.unstable:
        raise UnstableLoop(
            f"no controller of the method {method} was found that is stable with all "
            f"{len(loops.plants)} stages: lower the errors or the demands, or raise the effort")
    noise_um = demands.sensor_noise_um
    designed = feedback_from_control(controller, model, clock_period_s, model_sha256, method)
    report = {**designed.report, "demands": asdict(demands), "figures": asdict(figures),
              "margin_db": demands.margin_db(figures, first_mode_hz),
              "added_noise_um": noise_um * figures.noise_gain,
              "noise_voltage_v": noise_um * figures.noise_gain_v_per_um,
              **family.report(numbers)}
    return replace(designed, report=report)


def _decibels(ratio: float) -> float:
    return float(20 * np.log10(max(ratio, 1e-9)))


class _ClassicalFamily:
    """A form of `CANDIDATES`."""

    ANYWHERE, NEARBY, SIMPLEX = 60, 60, 250

    def __init__(self, model: StageModel, method: str, clock_period_s: float) -> None:
        self._model, self._clock_period_s = model, clock_period_s
        self._candidate = CANDIDATES[method]
        self.start, self.bounds = self._candidate.start, self._candidate.bounds

    def controller(self, numbers: FloatArray) -> control.StateSpace:
        """Return the controller of some numbers."""
        return self._candidate.controller(self._model, numbers, self._clock_period_s)

    def report(self, numbers: FloatArray) -> dict[str, Any]:
        """Return the part of the report that only this family has."""
        return {"numbers": dict(zip(self._candidate.names, map(float, numbers), strict=True))}


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
        self._gain_um_per_v = float(np.mean(hysteresis_gain_range(model)))

    def _synthesised(self, numbers: FloatArray) -> tuple[
            SampleRateWeights, control.StateSpace, control.StateSpace, float]:
        crossover, corner, peak, control_gain, roll_off, noise, of_gain, of_mode, *scalings = (
            map(float, numbers))
        weights = SampleRateWeights(
            crossover * self._mode_hz, corner * self._mode_hz, peak, control_gain,
            roll_off * self._mode_hz, noise, of_gain, of_mode)
        problem = light_mode_problem(self._model, weights, self._clock_period_s)
        controller, gamma = synthesise(scale(problem, scalings), SLACK, tolerance=COARSE)
        return weights, problem, controller, gamma

    def controller(self, numbers: FloatArray) -> control.StateSpace:
        """Return the controller of some numbers."""
        return self._synthesised(numbers)[2] * (1 / self._gain_um_per_v)

    def report(self, numbers: FloatArray) -> dict[str, Any]:
        """Return the part of the report that only this family has."""
        weights, problem, controller, gamma = self._synthesised(numbers)
        points: ComplexArray = np.exp(
            2j * np.pi * tick_frequencies(self._clock_period_s, 200) * self._clock_period_s)
        mu, _ = structured_singular_values(
            sampled_response(close(problem, controller), points), UNCERTAINTIES)
        return {"numbers": dict(zip(self.NAMES, map(float, numbers), strict=True)),
                "sample_rate_weights": asdict(weights), "gamma": float(gamma),
                "mu": float(mu.max())}


def _search(cost: Callable[[FloatArray], float], family: "_ClassicalFamily | _HInfinityFamily",
            effort: float, seed: int) -> FloatArray:
    """Return the logarithms of the best numbers: from anywhere, then nearby, then by a simplex."""
    rng = np.random.default_rng(seed)
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
    return minimize(cost, best, method="Nelder-Mead", options={
        "initial_simplex": simplex, "maxfev": max(10, round(effort * family.SIMPLEX)),
        "adaptive": True}).x
