# SPDX-License-Identifier: BSD-3-Clause
"""One feedback in the loop with many stages: the model, and those within its errors."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import control
import numpy as np
from scipy.linalg import solve_discrete_lyapunov

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_controller.feedback.loop_measures import BAND_EDGE
from piezo_controller.feedback.robustness import with_errors
from piezo_controller.feedback.synthesis.generalised_plant import (
    design_plant,
    hysteresis_gain_range,
    nominal_hysteresis_gain,
)
from piezo_models.cascade import StageModel

LOWEST_HZ = 1.0
HIGHEST = 0.4995
"""Highest frequency over the rate; less than half, which Tustin's rule maps to infinity."""

COARSE, FINE, NEAR = 120, 240, 24
"""Numbers of frequencies over the whole band, about the modes, where the loops differ, and near a
disturbance, where a controller may have a resonance."""

OVER_PEAK, MOST_FINE = 3.0, 2000
"""Frequencies per half width of a light mode's peak, and their largest number."""

AROUND = 3.0
"""Ratio of the highest frequency to the light mode's, and of that to the lowest."""

SLOW = 0.5
"""Part of the lowest disturbance's frequency below which no error may be amplified."""

ABOUT = np.linspace(-1.0, 1.0, 5)


@dataclass(frozen=True)
class ModelErrors:
    """Relative errors of a model, of either sign."""

    parameter: float = 0.05
    """Error of every parameter of creep, lag and modes."""
    light_mode: float = 0.20
    """Error of the frequency of the mode of least damping, which replaces `parameter` for it."""


@dataclass(frozen=True)
class LoopFigures:
    """Performance of a feedback; `worst` is over all stages, the rest is for the model itself."""

    unstable: int
    """Number of stages with which the loop is unstable."""
    largest_pole: float
    """Largest magnitude of a pole of any loop; below 1 if all are stable."""
    bandwidth_hz: float
    worst_bandwidth_hz: float
    """Frequency at which the closed loop from reference to displacement first falls to -3 dB."""
    attenuation_db: tuple[float, ...]
    worst_attenuation_db: tuple[float, ...]
    """Attenuation of a disturbance of the displacement, at the requested frequencies."""
    peak_sensitivity: float
    worst_peak_sensitivity: float
    """Peak of the sensitivity; the worst is infinite if a loop is unstable."""
    worst_slow_sensitivity: float
    """Largest sensitivity below half the lowest disturbance."""
    noise_gain: float
    """Displacement that white noise of the sensor causes, rms over that of the noise."""
    noise_gain_v_per_um: float
    """Voltage that it causes, rms over that of the noise."""


class PerturbedLoops:
    """Stages that are within the errors of a model, to be closed with feedbacks.

    The light mode has five frequencies within its error, at its least damping, and the gain of the
    hysteresis both its ends. For each of these ten, lag and other modes are all slow or all fast,
    and the other modes more or less damped: the corners with the largest phase errors. The least
    attenuation within the tolerance of each disturbance's frequency counts; the whole band has a
    number of coarse frequencies.

    The first of the sampled `plants` is that of the model itself, and `responses`, (P, F), are
    those of the plants (um/V) at the frequencies. The frequencies marked by `slow`, (F,), lie below
    half the lowest disturbance, and `disturbances` holds the indices of those about each
    disturbance.
    """

    def __init__(self, model: StageModel, errors: ModelErrors, clock_period_s: float = 25e-6,
                 disturbance_hz: tuple[float, ...] = (50.0, 100.0),
                 disturbance_tolerance: float = 0.0, delay_ticks: int = 1,
                 coarse: int = COARSE) -> None:
        self.plants = list(_perturbed(model, errors, clock_period_s, delay_ticks))
        highest_hz = HIGHEST / clock_period_s
        light = light_mode(model)
        mode_hz = model.dynamics.mode_frequencies_rad_per_s[light] / (2 * np.pi)
        over_peaks = OVER_PEAK * 2 * np.log(AROUND) / model.dynamics.damping_ratios[light]
        fine = min(max(FINE, round(over_peaks)), MOST_FINE)
        about = np.outer(disturbance_hz, 1 + disturbance_tolerance * ABOUT)
        self.frequency_hz = np.unique(np.concatenate([
            np.geomspace(LOWEST_HZ, highest_hz, coarse),
            np.geomspace(mode_hz / AROUND, mode_hz * AROUND, fine),
            *(_near(hz) for hz in disturbance_hz), about.ravel()]))
        self.slow = self.frequency_hz <= SLOW * min(disturbance_hz)
        self.points = np.exp(2j * np.pi * self.frequency_hz * clock_period_s)
        self.responses = np.array([_response(plant, self.points) for plant in self.plants])
        self.disturbances = [np.unique(np.searchsorted(self.frequency_hz, band)) for band in about]

    def measure(self, controller: control.StateSpace) -> LoopFigures:
        """Close every loop with a controller from error (um) to voltage (V)."""
        poles = np.array([np.abs(np.linalg.eigvals(closed_loop_matrix(plant, controller))).max()
                          for plant in self.plants])
        sensitivity = 1 / (1 + self.responses * _response(controller, self.points))
        below = np.abs(1 - sensitivity) < BAND_EDGE
        bandwidth_hz = np.where(below.any(axis=1), self.frequency_hz[below.argmax(axis=1)],
                                self.frequency_hz[-1])
        size = np.abs(sensitivity)
        attenuation_db = -20 * np.log10(np.column_stack(
            [size[:, band].max(axis=1) for band in self.disturbances]))
        unstable = int(np.sum(poles >= 1.0))
        noise = _noise_gains(self.plants[0], controller) if poles[0] < 1.0 else (np.inf, np.inf)
        return LoopFigures(
            unstable, float(poles.max()), float(bandwidth_hz[0]), float(bandwidth_hz.min()),
            tuple(map(float, attenuation_db[0])), tuple(map(float, attenuation_db.min(axis=0))),
            float(size[0].max()), np.inf if unstable else float(size.max()),
            float(size[:, self.slow].max()), *noise)


def light_mode(model: StageModel) -> int:
    """Return the index of the mode of least damping."""
    return int(np.argmin(model.dynamics.damping_ratios))


def closed_loop_matrix(plant: control.StateSpace, controller: control.StateSpace) -> FloatArray:
    """Return the system matrix of the loop of a strictly proper plant with a controller."""
    return np.block([[plant.A - plant.B @ controller.D @ plant.C, plant.B @ controller.C],
                     [-controller.B @ plant.C, controller.A]])


def _near(frequency_hz: float) -> FloatArray:
    return np.asarray(frequency_hz * np.geomspace(0.8, 1.25, NEAR))


def _perturbed(model: StageModel, errors: ModelErrors, clock_period_s: float,
               delay_ticks: int) -> Iterator[control.StateSpace]:
    """Yield the model's plant with its nominal gain, then the others."""
    def sampled(found: StageModel) -> control.StateSpace:
        return design_plant(found, clock_period_s, clock_period_s, delay_ticks=delay_ticks)[0]

    nominal_gain = nominal_hysteresis_gain(model)
    yield nominal_gain * sampled(model)
    pairs, modes = len(model.creep.poles_rad_per_s), len(model.dynamics.damping_ratios)
    light = light_mode(model)
    signs = [-1.0, 1.0]
    for part, slow, damped in product(np.linspace(-1.0, 1.0, 5), signs, signs):
        relative = errors.parameter * np.concatenate([
            np.full(2 * pairs, slow), [slow], np.full(modes, -slow), np.full(modes, damped)])
        relative[2 * pairs + 1 + light] = part * errors.light_mode
        relative[2 * pairs + 1 + modes + light] = -errors.parameter
        plant = sampled(with_errors(model, relative))
        for gain_um_per_v in hysteresis_gain_range(model):
            yield gain_um_per_v * plant


def _response(system: control.StateSpace, points: ComplexArray) -> ComplexArray:
    return system(points, squeeze=False)[0, 0]


def _noise_gains(plant: control.StateSpace,
                 controller: control.StateSpace) -> tuple[float, float]:
    """Return the rms of displacement and voltage under white noise of unit variance."""
    a = closed_loop_matrix(plant, controller)
    b = np.concatenate([-plant.B @ controller.D, -controller.B])
    covariance = solve_discrete_lyapunov(a, b @ b.T)
    displacement = np.concatenate([plant.C, np.zeros_like(controller.C)], axis=1)
    voltage = np.concatenate([-controller.D @ plant.C, controller.C], axis=1)
    direct = float(controller.D.item())
    return (float(np.sqrt((displacement @ covariance @ displacement.T).item())),
            float(np.sqrt((voltage @ covariance @ voltage.T).item() + direct**2)))
