# SPDX-License-Identifier: BSD-3-Clause
"""Robustness of a feedback against errors of the model: random errors, and the worst case."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import control
import numpy as np

from piezo_common.arrays import FloatArray
from piezo_controller.feedback.synthesis.generalised_plant import design_plant
from piezo_controller.feedback.synthesis.h_infinity import is_stable
from piezo_controller.feedback.synthesis.structured_singular_value import sampled_response
from piezo_models.cascade import StageModel
from piezo_models.linear.creep_errors import with_creep_errors
from piezo_models.linear.dynamics_vector import dynamics_of_vector, dynamics_vector

SAMPLES = 200
SWEEPS = 2
PARAMETER_ERROR = 0.05
FREQUENCIES = 100


@dataclass(frozen=True)
class Robustness:
    """Robustness of a feedback."""

    samples: int
    unstable_samples: int
    """Number of loops with random errors, and of the unstable ones among them."""
    worst_peak_sensitivity: float
    """Peak at the worst errors found; infinite if the loop is unstable there."""

    @property
    def stable(self) -> bool:
        """Return whether every loop that was tested is stable."""
        return self.unstable_samples == 0 and np.isfinite(self.worst_peak_sensitivity)


@dataclass(frozen=True)
class PlantErrors:
    """Plants within the errors of a model, for loops of one axis or several."""

    plant_of: Callable[[FloatArray], control.StateSpace]
    """Takes errors between -1 and 1, (count,); returns a plant (um/V) at the controller's rate."""
    count: int

    def drawn(self, samples: int) -> list[control.StateSpace]:
        """Return the first plants with the random errors of `robustness`."""
        return [self.plant_of(errors) for errors in self._draws(samples)]

    def robustness(self, controller: control.StateSpace, samples: int = SAMPLES) -> Robustness:
        """Close the loop with plants of random errors, then search for the worst ones.

        The worst case is searched for among the extremes of all errors: one error after another is
        moved to the extreme with the higher peak of the sensitivity, until none raises it. The
        controller is discrete, from errors (um) to voltages (V).
        """
        frequency_hz = np.geomspace(0.1, 0.5 / controller.dt, FREQUENCIES)
        points = np.exp(2j * np.pi * frequency_hz * controller.dt)
        fed_back = sampled_response(controller, points)
        one = np.eye(controller.ninputs)

        def peak(errors: FloatArray) -> float:
            plant = self.plant_of(errors)
            if not is_stable(control.feedback(plant * controller, one)):
                return np.inf
            # The smallest singular value.
            return float(1 / np.linalg.norm(
                one + sampled_response(plant, points) @ fed_back, -2, axis=(1, 2)).min())

        draws = self._draws(samples)
        peaks = np.array([peak(errors) for errors in draws])
        errors = np.sign(draws[np.argmax(peaks)])
        worst = peak(errors)
        for _ in range(SWEEPS):
            for index in range(self.count):
                turned = errors.copy()
                turned[index] = -turned[index]
                value = peak(turned)
                if value > worst:
                    worst, errors = value, turned
        return Robustness(samples, int(np.isinf(peaks).sum()), float(worst))

    def _draws(self, samples: int) -> FloatArray:
        return np.random.default_rng(0).uniform(-1, 1, (samples, self.count))


def plant_errors(model: StageModel, tick_s: float, clock_period_s: float, gain_spread: float,
                 at_once: bool = False, delay_ticks: int = 1) -> PlantErrors:
    """Return the plants of a model with errors of all parameters, and with other gains.

    The gain of the hysteresis lies within ``1 +- gain_spread`` of its nominal value. The other
    arguments are those of `design_plant`.
    """
    def plant_of(errors: FloatArray) -> control.StateSpace:
        plant, gain_um_per_v = design_plant(
            with_errors(model, PARAMETER_ERROR * errors[1:]), tick_s, clock_period_s, at_once,
            delay_ticks)
        return gain_um_per_v * (1 + gain_spread * errors[0]) * plant

    return PlantErrors(plant_of, 1 + 2 * len(model.creep.poles_rad_per_s)
                       + dynamics_vector(model.dynamics).size)


def with_errors(model: StageModel, errors: FloatArray) -> StageModel:
    """Return the model with relative errors in the parameters of its linear dynamics."""
    dynamics = model.dynamics
    of_creep = 2 * len(model.creep.poles_rad_per_s)
    return replace(
        model, creep=with_creep_errors(model.creep, errors[:of_creep]),
        dynamics=dynamics_of_vector(
            dynamics_vector(dynamics) * (1 + errors[of_creep:]),
            len(dynamics.mode_frequencies_rad_per_s),
            len(dynamics.antiresonance_frequencies_rad_per_s)))
