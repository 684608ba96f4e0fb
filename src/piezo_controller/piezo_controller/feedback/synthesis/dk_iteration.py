# SPDX-License-Identifier: BSD-3-Clause
"""D-K iteration: the controller of smallest structured singular value (thesis 5.3.1)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import control
import numpy as np
from scipy.optimize import least_squares, minimize
from scipy.signal import zpk2ss

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_controller.feedback.synthesis.h_infinity import NoController, close, synthesise
from piezo_controller.feedback.synthesis.structured_singular_value import (
    sampled_response,
    structured_singular_values,
)
from piezo_models.linear.connections import inverse

ITERATIONS = 3
SEARCHED = 30
COARSE = 1e-3
FREQUENCIES = 60
LOWEST_HZ = 1e-3
SCALING_ORDER = 1
# A scaling matters where the structured singular value is near its peak.
IMPORTANCE = 4


Scaling: TypeAlias = "float | control.StateSpace"
"""Scaling of one scalar uncertainty."""


@dataclass(frozen=True)
class RobustSynthesis:
    """The best iterate."""

    controller: control.StateSpace

    gamma: float
    """Norm of the closed loop with the scalings that the controller was designed for."""
    scalings: tuple[Scaling, ...]
    """Scaling D of each scalar uncertainty."""
    history: list[float]
    """Peak of the structured singular value after each synthesis. The first is without scalings,
    the last is that of the controller."""


def iterate(plant: control.StateSpace, scalars: int, dynamic: bool = False,
            slack: float = 0.0, axes: int = 1) -> RobustSynthesis:
    """Alternate between synthesis (K) and scaling (D), and keep the best controller.

    The iteration converges slowly, as an optimal K levels the peaks that the next D could lower.
    Constant scalings are therefore refined by a direct search around the synthesis, from the result
    of the iteration. Dynamic ones, which depend on frequency and add to the controller's order, are
    iterated from there.

    Each axis of the generalised plant has a number of scalar uncertainties; those of one kind have
    a common, constant scaling in all axes. For the order of inputs and outputs see
    `structured_singular_values`, for the last of each and for the slack of the final synthesis
    `synthesise`. Raises `NoController` if there is none even without scalings.
    """
    iteration = _Iteration(plant, scalars, axes)
    iteration.synthesise(np.ones(scalars))
    for _ in range(ITERATIONS - 1):
        iteration.synthesise(constant_scaling(iteration.responses, scalars, axes))
    iteration.search()
    if dynamic:
        for _ in range(ITERATIONS):
            iteration.synthesise(iteration.fitted_scalings())
    return iteration.best(slack)


class _Iteration:
    """State of an iteration, and the best result so far."""

    def __init__(self, plant: control.StateSpace, scalars: int, axes: int) -> None:
        self._plant = plant
        self._scalars, self._axes = scalars, axes
        self._frequency_hz = tick_frequencies(plant.dt)
        self._points = np.exp(2j * np.pi * self._frequency_hz * plant.dt)
        self._history: list[float] = []
        self._best: tuple[float, Sequence[Scaling] | FloatArray] = np.inf, ()

    def synthesise(self, scalings: Sequence[Scaling] | FloatArray) -> None:
        """Design the controller for the present scalings (K-step)."""
        controller, _ = synthesise(self._scaled(scalings), tolerance=COARSE, axes=self._axes)
        self._take(scalings, controller)

    def _take(self, scalings: Sequence[Scaling] | FloatArray,
              controller: control.StateSpace) -> None:
        self.responses = sampled_response(close(self._plant, controller), self._points)
        self.mu, self._profiles = structured_singular_values(
            self.responses, self._scalars * self._axes)
        self._history.append(float(self.mu.max()))
        self._best = min(self._best, (self._history[-1], scalings), key=lambda pair: pair[0])

    def search(self) -> None:
        """Search the constant scalings of smallest norm, beginning with the best so far."""
        def norm(log_d: FloatArray) -> float:
            try:
                return synthesise(self._scaled(np.exp(log_d)), largest_norm=10.0,
                                  tolerance=COARSE, axes=self._axes)[1]
            except NoController:
                return np.inf

        start = np.log(self._best[1])
        simplex = start + 0.4 * np.vstack([np.zeros(self._scalars), np.eye(self._scalars)])
        found = minimize(norm, start, method="Nelder-Mead", options={
            "initial_simplex": simplex, "maxfev": SEARCHED, "xatol": 1e-2, "fatol": COARSE})
        self.synthesise(np.exp(found.x))

    def fitted_scalings(self) -> list[control.StateSpace]:
        """Fit dynamic scalings to the present controller (D-step)."""
        importance = (self.mu / self.mu.max()) ** IMPORTANCE
        return [fit_scaling(self._frequency_hz, profile, importance, self._plant.dt)
                for profile in self._profiles.T]

    def best(self, slack: float) -> RobustSynthesis:
        """Synthesise with the best scalings and the given slack."""
        controller, gamma = synthesise(self._scaled(self._best[1]), slack, axes=self._axes)
        self._take(self._best[1], controller)
        return RobustSynthesis(controller, gamma, tuple(self._best[1]), self._history)

    def _scaled(self, scalings: Sequence[Scaling] | FloatArray) -> control.StateSpace:
        return scale(self._plant, scalings, self._axes)


def tick_frequencies(tick_s: float, count: int = FREQUENCIES) -> FloatArray:
    """Return zero and logarithmically spaced frequencies (Hz) up to half the rate."""
    return np.r_[0.0, np.geomspace(LOWEST_HZ, 0.5 / tick_s, count)]


def constant_scaling(responses: ComplexArray, scalars: int, axes: int = 1) -> FloatArray:
    """Return positive numbers d with the lowest peak of the largest singular value of D M D^-1.

    The responses M have the shape (F, outputs, inputs), the numbers (scalars,).
    """
    _, outputs, inputs = responses.shape

    def peak(log_d: FloatArray) -> float:
        left, right = np.ones(outputs), np.ones(inputs)
        scaled = slice(scalars * axes)
        left[scaled], right[scaled] = np.repeat((np.exp(log_d), np.exp(-log_d)), axes, axis=1)
        return np.linalg.norm(left[:, None] * responses * right, ord=2, axis=(1, 2)).max()

    # The peak is convex in the logarithms, but has kinks.
    found = minimize(peak, np.zeros(scalars), method="Nelder-Mead",
                     options={"xatol": 1e-3, "fatol": 1e-5})
    return np.exp(found.x)


def fit_scaling(frequency_hz: FloatArray, magnitude: FloatArray, importance: FloatArray,
                tick_s: float) -> control.StateSpace:
    """Fit a stable system with a stable inverse, of real zeros and poles, to a magnitude, (F,)."""
    points = np.exp(2j * np.pi * frequency_hz * tick_s)
    target = np.log(magnitude)

    def roots(parameters: FloatArray) -> tuple[FloatArray, ...]:
        # Corner frequencies of any value are mapped to the inside of the unit circle.
        return tuple(np.exp(-np.exp(each)) for each in np.split(parameters[:-1], 2))

    def residual(parameters: FloatArray) -> FloatArray:
        zeros, poles = roots(parameters)
        fitted = parameters[-1] + sum(
            np.log(np.abs(points - zero) / np.abs(points - pole))
            for zero, pole in zip(zeros, poles, strict=True))
        return importance * (fitted - target)

    corners = np.log(2 * np.pi * tick_s * np.geomspace(1.0, 0.2 / tick_s, SCALING_ORDER + 2)[1:-1])
    start = np.r_[corners + 0.1, corners - 0.1, np.average(target, weights=importance)]
    limits = np.r_[np.full(2 * SCALING_ORDER, 6.0), np.inf]
    found = least_squares(residual, start, bounds=(-limits - 6.0, limits - 4.0)).x
    zeros, poles = roots(found)
    return control.ss(*zpk2ss(zeros, poles, np.exp(found[-1])), tick_s)


def scale(plant: control.StateSpace, scalings: Sequence[Scaling] | FloatArray,
          axes: int = 1) -> control.StateSpace:
    """Scale the outputs of the uncertainties by D, their inputs by the inverse.

    There is a scaling for each scalar uncertainty of an axis; a system must have a stable inverse.
    """
    systems = [scaling if isinstance(scaling, control.StateSpace)
               else control.ss([], [], [], [[scaling]], plant.dt)
               for scaling in scalings for _ in range(axes)]
    others_out, others_in = (
        control.ss([], [], [], np.eye(count - len(systems)), plant.dt)
        for count in (plant.noutputs, plant.ninputs))
    inverses = [inverse(system) for system in systems]
    return control.append(*systems, others_out) * plant * control.append(*inverses, others_in)
