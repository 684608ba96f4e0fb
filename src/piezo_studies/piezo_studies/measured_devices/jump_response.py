# SPDX-License-Identifier: BSD-3-Clause
"""Identify vibration from a single jump of the voltage, for recordings without a square wave."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.conditioning.waveforms import played
from piezo_identification.estimators.estimate import (
    Estimate,
    OrderTrial,
    order_trial,
    parameter_covariance,
)
from piezo_models.linear.dynamics import ElectricVibrationDynamics, simulate_linear, zoh
from piezo_models.linear.dynamics_vector import (
    dynamics_of_vector,
    dynamics_vector,
    split_dynamics_vector,
)
from piezo_recorder.reading.recording import Recording

MOST_MODES = 3
"""Largest number of vibration modes in the search."""

SAMPLES_BEFORE = 50
"""Samples of the rest before the jump that determine its level."""

SEARCH_WIDTH = 3.0
"""Largest change of the logarithm of a parameter in the fit."""

LEAST_JUMP = 10.0
"""Smallest ratio of a jump to the largest other change of the voltage between samples."""


@dataclass(frozen=True, eq=False)
class JumpResponse:
    """A rest, a jump, and the response."""

    sample_period_s: float

    jump: int
    """First sample with the new voltage."""
    voltage_v: FloatArray
    displacement_um: FloatArray
    """Shape (N,)."""

    @property
    def time_s(self) -> FloatArray:
        """Time since the jump, shape (N,)."""
        return np.asarray(
            (np.arange(self.voltage_v.size) - self.jump) * self.sample_period_s, dtype=float)

    def basis(self, dynamics: ElectricVibrationDynamics) -> FloatArray:
        """Return regressors of the response, shape (N, 4).

        They are a constant and, passed through the dynamics, the jump of the hysteresis output and
        its later change: between two reversals, the hysteresis is close to a parabola in the
        voltage.
        """
        system = zoh(dynamics.state_space(), self.sample_period_s)
        after = np.arange(self.voltage_v.size) >= self.jump
        way = np.where(after, self.voltage_v - self.voltage_v[self.jump], 0.0)
        way = way / (np.abs(way).max() or 1.0)
        inputs = [after.astype(float), way, way**2]
        return np.column_stack(
            [np.ones(after.size), *(simulate_linear(system, column) for column in inputs)]
        )

    def first(self, duration_s: float) -> "JumpResponse":
        """Return the response up to a time after the jump."""
        end = self.jump + round(duration_s / self.sample_period_s)
        return JumpResponse(
            self.sample_period_s, self.jump, self.voltage_v[:end], self.displacement_um[:end]
        )


def jump_response(recording: Recording, duration_s: float = 0.05) -> JumpResponse:
    """Extract the largest jump of the voltage from a recording, with the rest before it.

    Parameters
    ----------
    duration_s : float
        Time after the jump.

    Raises
    ------
    ValueError
        If no change of the voltage is clearly the largest, or the recording ends too soon after it.
    """
    part = played(recording)
    change_v = np.abs(np.diff(part.voltage_v))
    jump = int(np.argmax(change_v)) + 1
    others_v = np.delete(change_v, jump - 1)
    if others_v.size == 0 or change_v[jump - 1] <= LEAST_JUMP * others_v.max():
        raise ValueError(
            f"{recording.path} has no jump of the voltage that stands out: "
            "give a recording with a single step"
        )
    start, end = max(0, jump - SAMPLES_BEFORE), jump + round(duration_s / part.sample_period_s)
    if end > part.voltage_v.size or jump < 2:
        raise ValueError(
            f"{recording.path} has no rest before its jump, or ends less than {duration_s:g} s "
            "after it: record longer"
        )
    return JumpResponse(
        part.sample_period_s, jump - start, part.voltage_v[start:end],
        part.displacement_um[start:end],
    )


def estimate_jump_dynamics(response: JumpResponse, mode_count: int | None = None) -> Estimate:
    """Estimate lag, modes, and an antiresonance between every two neighbouring modes.

    The poles of the free decay give initial values of the modes. The physical parameters are then
    refined by minimizing the output error, with all coefficients of `JumpResponse.basis` free.

    Parameters
    ----------
    mode_count : int, optional
        Number of modes; by default chosen by the Bayesian information criterion.

    Returns
    -------
    Estimate
        Estimate whose `order` is the number of modes.

    Raises
    ------
    ValueError
        If the decay shows fewer modes than requested.
    """
    fits = {}
    for count in range(1, MOST_MODES + 1) if mode_count is None else [mode_count]:
        start = _starting_dynamics(response, count)
        if start is not None:
            fits[count] = _fit(response, start)
    if not fits:
        raise ValueError("the response to the jump shows no such modes: give fewer")
    order = min(fits, key=lambda count: fits[count][2].information)
    model, deviations, _ = fits[order]
    return Estimate(
        model, deviations, order, tuple(trial for *_, trial in fits.values()),
        order_given=mode_count is not None,
    )


def _fit(
    response: JumpResponse, start: ElectricVibrationDynamics,
) -> tuple[ElectricVibrationDynamics, dict[str, Any], OrderTrial]:
    """Return the dynamics with the least output error, their standard deviations, and the trial."""
    modes = len(start.mode_frequencies_rad_per_s)
    antiresonances = len(start.antiresonance_frequencies_rad_per_s)

    def residual(logarithms: FloatArray) -> FloatArray:
        basis = response.basis(dynamics_of_vector(np.exp(logarithms), modes, antiresonances))
        coefficients = np.linalg.lstsq(basis, response.displacement_um, rcond=1e-12)[0]
        return response.displacement_um - basis @ coefficients

    logarithms = np.log(dynamics_vector(start))
    solution = least_squares(
        residual, logarithms, xtol=1e-10, ftol=1e-12, max_nfev=100,
        bounds=(logarithms - SEARCH_WIDTH, logarithms + SEARCH_WIDTH),
    )
    vector = np.exp(solution.x)
    parameters = vector.size + 4
    covariance = parameter_covariance(solution.jac, solution.fun, parameters)
    deviations = vector * np.sqrt(np.diag(covariance))
    return (
        dynamics_of_vector(vector, modes, antiresonances),
        split_dynamics_vector(deviations, modes, antiresonances),
        order_trial(modes, solution.fun, parameters),
    )


def _starting_dynamics(response: JumpResponse, mode_count: int,
                       ) -> ElectricVibrationDynamics | None:
    """Return initial modes from the free decay; None if it shows fewer."""
    after = slice(response.jump + 1, None)
    voltage_v, displacement_um = response.voltage_v[after], response.displacement_um[after]
    # Remove the part that follows the voltage, as fitted to the later half.
    half = voltage_v.size // 2
    terms = min(2, np.unique(voltage_v[half:]).size - 1)
    slow_um = np.polynomial.Polynomial.fit(voltage_v[half:], displacement_um[half:], terms)
    poles = free_decay_poles(
        displacement_um - slow_um(voltage_v), response.sample_period_s, 2 * mode_count
    )
    pairs = poles[poles.imag > 0.0]
    if pairs.size < mode_count:
        return None
    pairs = pairs[np.argsort(np.abs(pairs))]
    frequencies = np.abs(pairs)
    dampings = np.maximum(-pairs.real, 1e-3 * frequencies) / frequencies
    between = np.sqrt(frequencies[1:] * frequencies[:-1])
    return ElectricVibrationDynamics(
        0.5 * response.sample_period_s, tuple(frequencies), tuple(dampings),
        tuple(between), tuple(np.full(between.size, 0.05)),
    )


def free_decay_poles(decay: FloatArray, sample_period_s: float, order: int) -> ComplexArray:
    """Return the poles (rad/s, complex) of a free decay to an unknown end value.

    The Hankel matrix of the decay has the rank of the system. The shift of its signal subspace has
    the discrete poles as eigenvalues; the eigenvalue 1 of the end value is dropped.

    Parameters
    ----------
    decay : ndarray, shape (N,)
    order : int
        Number of poles.

    Raises
    ------
    ValueError
        If the decay is too short.
    """
    if decay.size < 4 * (order + 1):
        raise ValueError(
            f"a decay of {decay.size} samples is too short for {order} poles: "
            "use a longer period of the square wave"
        )
    hankel = np.lib.stride_tricks.sliding_window_view(decay, decay.size // 2).T
    subspace = np.linalg.svd(hankel, full_matrices=False)[0][:, : order + 1]
    shift = np.linalg.lstsq(subspace[:-1], subspace[1:], rcond=None)[0]
    discrete = np.linalg.eigvals(shift).astype(complex)
    # Prefer a real eigenvalue near 1 as that of the end value.
    discrete = np.delete(discrete, np.argmin(np.abs(discrete - 1.0) + 2.0 * (discrete.imag != 0.0)))
    # Negative eigenvalues have no continuous pole; a fast decay is nearest to them.
    discrete[discrete.imag == 0.0] = np.abs(discrete[discrete.imag == 0.0])
    return np.log(discrete) / sample_period_s
