# SPDX-License-Identifier: BSD-3-Clause
"""Electric and vibration dynamics from a short square wave: subspace start, output-error fit."""

import numpy as np
from piezo_models.linear import (
    ElectricVibrationDynamics,
    equilibrium_state,
    simulate_linear,
    zoh,
)
from scipy.optimize import least_squares
from scipy.signal import lfilter, lfilter_zi

from piezo_identification.waveforms import played, samples_per_mean, square_wave

WARM_UP_S = 0.1
"""Part at the start in which the approach from rest still shows."""


def estimate_dynamics(recording, creep, mode_count=2):
    """Estimate the electric lag and the vibration modes (4.3) from a square wave of short period.

    The creep is taken off by its inverse. What follows a step is a free decay, whose poles a
    subspace method (eigensystem realisation) finds without a starting guess; the physical
    parameters are then refined for the least output error of the exactly sampled model, with
    offset and gain of the hysteresis (4.5) and the initial creep free.

    Parameters
    ----------
    recording : Recording
        Of the dynamics experiment, at the full sample clock.
    creep : CreepDynamics
    mode_count : int
        Number of vibration modes.

    Returns
    -------
    ElectricVibrationDynamics

    Raises
    ------
    ValueError
        If the recording has gaps, is no square wave, is averaged, or is too short.
    """
    part = played(recording)
    if samples_per_mean(part) > 1:
        raise ValueError(
            f"{recording.path} has means over {part.sample_period_s:g} s: "
            "record the dynamics at the full sample clock"
        )
    wave = square_wave(part)
    period_s = part.sample_period_s
    quick = remove_creep(part.displacement_um, creep, period_s)
    warm_up = round(WARM_UP_S / period_s)
    start = _dynamics_of_poles(
        free_decay_poles(_mean_step(recording, quick, wave, warm_up), period_s, 2 * mode_count + 1)
    )

    time_s = np.arange(quick.size) * period_s
    fixed = [np.ones_like(time_s), *(np.exp(-z * time_s) for z in creep.zeros_rad_per_s)]
    basis = np.column_stack([np.zeros_like(time_s), *fixed])[warm_up:]

    def residual(logarithms):
        model = _dynamics_of_parameters(np.exp(logarithms)).state_space()
        initial = equilibrium_state(model, wave.level[0])
        basis[:, 0] = simulate_linear(zoh(model, period_s), wave.level, initial)[warm_up:]
        coefficients = np.linalg.lstsq(basis, quick[warm_up:], rcond=1e-12)[0]
        return quick[warm_up:] - basis @ coefficients

    logarithms = np.log([start.time_constant_s, *start.mode_frequencies_rad_per_s,
                         *start.damping_ratios])
    solution = least_squares(residual, logarithms, xtol=1e-10, ftol=1e-12, max_nfev=50)
    return _dynamics_of_parameters(np.exp(solution.x))


def low_frequency_delay_s(dynamics):
    """Delay of the dynamics at low frequency, the coefficient of (4.18) and (4.19)."""
    def sum_of_modes(frequencies, dampings):
        return sum(2.0 * d / w for w, d in zip(frequencies, dampings, strict=True))

    return (
        dynamics.time_constant_s
        + sum_of_modes(dynamics.mode_frequencies_rad_per_s, dynamics.damping_ratios)
        - sum_of_modes(dynamics.antiresonance_frequencies_rad_per_s,
                       dynamics.antiresonance_damping_ratios)
    )


def remove_creep(signal, creep, sample_period_s):
    """Pass a uniformly sampled signal through the inverse of the creep, Fig. 4.7.

    Parameters
    ----------
    signal : ndarray, shape (N,)
    creep : CreepDynamics
    sample_period_s : float
        Short beside the creep; the signal is taken for linear between samples (bilinear rule).

    Returns
    -------
    ndarray, shape (N,)
        Begins in equilibrium with the first sample.
    """
    for pole, zero in zip(creep.poles_rad_per_s, creep.zeros_rad_per_s, strict=True):
        halves = 0.5 * sample_period_s * np.array([pole, zero])
        numerator = np.array([1.0 + halves[0], halves[0] - 1.0]) / (1.0 + halves[1])
        denominator = np.array([1.0, (halves[1] - 1.0) / (1.0 + halves[1])])
        initial = lfilter_zi(numerator, denominator) * signal[0]
        signal = lfilter(numerator, denominator, signal, zi=initial)[0]
    return signal


def free_decay_poles(decay, sample_period_s, order):
    """Poles (rad/s, complex) of a free decay around an unknown end value.

    The Hankel matrix of the decay has the rank of the system; the shift of its signal subspace has
    the discrete poles as eigenvalues, among them the 1 of the end value, which is dropped.

    Parameters
    ----------
    decay : ndarray, shape (N,)
    sample_period_s : float
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
    discrete = np.delete(discrete, np.argmin(np.abs(discrete - 1.0)))
    return np.log(discrete) / sample_period_s


def _mean_step(recording, signal, wave, warm_up):
    """Mean response to the upward and the reversed downward steps."""
    steps = wave.steps[wave.steps > warm_up]
    length = np.diff(wave.steps).min(initial=signal.size)
    steps = steps[steps + length < signal.size]
    upward = wave.level[steps] == 1.0
    if not (upward.any() and (~upward).any()):
        raise ValueError(f"{recording.path} is too short: record several periods of the dynamics")
    responses = signal[steps[:, None] + np.arange(1, length + 1)]
    return 0.5 * (responses[upward].mean(axis=0) - responses[~upward].mean(axis=0))


def _dynamics_of_parameters(parameters):
    """Time constant, frequencies, dampings in one vector."""
    modes = (len(parameters) - 1) // 2
    return ElectricVibrationDynamics(
        parameters[0], tuple(parameters[1 : 1 + modes]), tuple(parameters[1 + modes :])
    )


def _dynamics_of_poles(poles):
    """Physical parameters; real poles beyond the electric one pair up to overdamped modes."""
    # A pole that noise made unstable or negative-real starts as a fast stable one.
    poles = np.where(poles.real < 0.0, poles, -np.abs(poles) - 1.0)
    pairs = poles[poles.imag > 1e-6 * np.abs(poles)]
    real = np.sort(-poles[np.abs(poles.imag) <= 1e-6 * np.abs(poles)].real)
    time_constant_s = 1.0 / real[0]
    products = [abs(pole) ** 2 for pole in pairs] + list(real[1::2] * real[2::2])
    sums = [-2.0 * pole.real for pole in pairs] + list(real[1::2] + real[2::2])
    frequencies = np.sqrt(products)
    dampings = np.array(sums) / (2.0 * frequencies)
    order = np.argsort(frequencies)
    return ElectricVibrationDynamics(
        float(time_constant_s), tuple(frequencies[order]), tuple(dampings[order])
    )
