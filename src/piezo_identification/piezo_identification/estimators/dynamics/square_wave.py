# SPDX-License-Identifier: BSD-3-Clause
"""Electric and vibration dynamics from a short square wave: subspace start, output-error fit."""

import control
import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.conditioning.creep_removal import remove_creep
from piezo_identification.conditioning.recording_start import square_part
from piezo_identification.conditioning.waveforms import played, samples_per_mean, square_wave
from piezo_identification.estimators.dynamics.output_error import fit_output_error
from piezo_identification.estimators.estimate import Estimate
from piezo_models.linear.dynamics import (
    CreepDynamics,
    ElectricVibrationDynamics,
    continue_linear,
    simulate_linear,
    zoh,
)
from piezo_recorder.reading.recording import Recording

WARM_UP_S = 0.3
"""Part at the start that is not used, as the approach from rest still shows in it."""


def estimate_dynamics(
    recording: Recording, creep: CreepDynamics, mode_count: int | None = None,
) -> Estimate:
    """Estimate the electric lag and the vibration modes (4.3) from a square wave of short period.

    The creep is removed by its inverse, and the periods are averaged. What follows a step is a
    free decay, whose poles a subspace method (eigensystem realisation) finds without a starting
    guess; the physical parameters are then refined for the least output error of the exactly
    sampled model in its periodic state, with offset and gain of the hysteresis (4.5) and the
    initial creep free.

    Parameters
    ----------
    recording : Recording
        Of the dynamics experiment, at the full sample clock.
    creep : CreepDynamics
    mode_count : int, optional
        Number of vibration modes, without antiresonances; by default as many of both as the
        Bayesian information criterion justifies.

    Returns
    -------
    Estimate
        Its model is an `ElectricVibrationDynamics`; its order counts modes. The creep is taken for
        exact in the standard deviations.

    Raises
    ------
    ValueError
        If the recording has gaps, is no square wave, is averaged, or is too short.
    """
    record = _DynamicsRecord(recording, creep)
    return fit_output_error(
        record.respond, record.measured_um, record.fixed, record.start, mode_count
    )


class _DynamicsRecord:
    """The mean period of the record without creep, and the response of models to it."""

    def __init__(self, recording: Recording, creep: CreepDynamics) -> None:
        part = square_part(played_at_the_clock(recording))
        self.period_s = part.sample_period_s
        wave = square_wave(part)
        quick_um = remove_creep(part.displacement_um, creep, self.period_s)
        steps = wave.steps[wave.steps >= WARM_UP_S / self.period_s]
        if steps.size < 3:
            raise ValueError(
                f"{recording.path} is too short: record several periods of the dynamics"
            )
        self.length = steps[2] - steps[0]
        if np.any(steps[2:] - steps[:-2] != self.length):
            raise ValueError(f"{recording.path} is not periodic: record one square wave throughout")
        runs = (steps[-1] - steps[0]) // self.length

        def fold(signal: FloatArray) -> FloatArray:
            signal = signal[steps[0] : steps[0] + runs * self.length]
            return signal.reshape(runs, self.length).mean(axis=0)

        self.level = wave.level[steps[0] : steps[0] + self.length]
        self.measured_um = fold(quick_um)
        drift = drift_basis(np.arange(quick_um.size) * self.period_s, creep)
        self.fixed = np.column_stack([fold(column) for column in drift.T])
        half = steps[1] - steps[0]
        count = min(half, self.length - half)
        # Both half periods are one free decay, but for offset and sign.
        self.decay_um = self.measured_um[1:count] - self.measured_um[half + 1 : half + count]

    def start(self, mode_count: int) -> ElectricVibrationDynamics:
        """Dynamics of the free decay, found by subspace."""
        return dynamics_of_poles(
            free_decay_poles(self.decay_um, self.period_s, 2 * mode_count + 1)
        )

    def respond(self, dynamics: ElectricVibrationDynamics) -> FloatArray:
        """Response of the dynamics to the mean period."""
        return periodic_response(zoh(dynamics.state_space(), self.period_s), self.level)


def played_at_the_clock(recording: Recording) -> Recording:
    """Part of a recording in which a waveform plays, not averaged.

    Raises
    ------
    ValueError
        If samples are missing, or are means over several.
    """
    part = played(recording)
    if samples_per_mean(part) > 1:
        raise ValueError(
            f"{recording.path} has means over {part.sample_period_s:g} s: "
            "record the dynamics at the full sample clock"
        )
    return part


def drift_basis(time_s: FloatArray, creep: CreepDynamics) -> FloatArray:
    """Columns (N, K) of what a record without creep may still hold: offset and initial creep."""
    return np.column_stack(
        [np.ones_like(time_s), *(np.exp(-zero * time_s) for zero in creep.zeros_rad_per_s)]
    )


def periodic_response(discrete_system: control.StateSpace, period: FloatArray) -> FloatArray:
    """Output of a stable discrete system over one period of a periodic input.

    Parameters
    ----------
    discrete_system : control.StateSpace
    period : ndarray, shape (N,)
        One period of the input.

    Returns
    -------
    ndarray, shape (N,)
    """
    from_zero = continue_linear(discrete_system, period, np.zeros(discrete_system.nstates))[1]
    decay = np.linalg.matrix_power(discrete_system.A, period.size)
    initial = np.linalg.solve(np.eye(from_zero.size) - decay, from_zero)
    return simulate_linear(discrete_system, period, initial)


def free_decay_poles(decay: FloatArray, sample_period_s: float, order: int) -> ComplexArray:
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
    # Reals come in an even number here, so that the end value's is one of them, or there is none.
    discrete = np.delete(discrete, np.argmin(np.abs(discrete - 1.0) + 2.0 * (discrete.imag != 0.0)))
    # A negative eigenvalue has no continuous pole: a fast one is the nearest there is.
    discrete[discrete.imag == 0.0] = np.abs(discrete[discrete.imag == 0.0])
    return np.log(discrete) / sample_period_s


def dynamics_of_poles(poles: ComplexArray) -> ElectricVibrationDynamics:
    """Electric lag and modes with given poles.

    Parameters
    ----------
    poles : ndarray of complex, shape (1 + 2 modes,)
        In rad/s, closed under conjugation. Unstable ones are taken for their stable mirror image;
        real ones beyond the electric lag pair up to overdamped modes.

    Returns
    -------
    ElectricVibrationDynamics
    """
    mode_count = (poles.size - 1) // 2
    # What noise made unstable starts as its stable mirror image.
    poles = -np.maximum(np.abs(poles.real), 1e-6 * np.abs(poles)) + 1j * poles.imag
    pairs = poles[poles.imag > 0.0][:mode_count]
    real = np.sort(-poles[poles.imag == 0.0].real)
    # Where all poles oscillate, the electric lag starts from the slowest of them.
    time_constant_s = 1.0 / (real[0] if real.size else np.abs(poles).min())
    products = np.concatenate([np.abs(pairs) ** 2, real[1::2] * real[2::2]])
    sums = np.concatenate([-2.0 * pairs.real, real[1::2] + real[2::2]])
    frequencies = np.sqrt(products)
    order = np.argsort(frequencies)
    dampings = sums / (2.0 * frequencies)
    return ElectricVibrationDynamics(
        float(time_constant_s), tuple(frequencies[order]), tuple(dampings[order])
    )
