# SPDX-License-Identifier: BSD-3-Clause
"""Electric and vibration dynamics from a short square wave: subspace start, output-error fit."""

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.conditioning.creep_removal import remove_creep
from piezo_identification.conditioning.recording_start import square_part
from piezo_identification.conditioning.settled_periods import first_settled_step
from piezo_identification.conditioning.waveforms import square_wave
from piezo_identification.estimators.dynamics.fast_creep import fit_beside_fast_creep
from piezo_identification.estimators.dynamics.fast_record import FastRecord
from piezo_identification.estimators.dynamics.fast_signals import drift_basis, played_at_the_clock
from piezo_identification.estimators.estimate import Estimate
from piezo_identification.estimators.poles.pole_responses import HeldInput
from piezo_models.linear.dynamics import CreepDynamics
from piezo_recorder.reading.recording import Recording

WARM_UP_S = 0.3
"""Part at the start that is not used, as the approach from rest still shows in it; more is left out
where it shows for longer."""

SKIPPED_SAMPLES = (1, 6, 20)
"""So many samples of a decay after a step are skipped in turn, as a delay may hold it up."""


def estimate_dynamics(
    recording: Recording, creep: CreepDynamics, mode_count: int | None = None,
    delay: float | None = None,
) -> Estimate:
    """Estimate electric lag, vibration modes (4.3) and delay from a square wave of short period.

    The creep is removed by its inverse, and the periods are averaged. What follows a step is a
    free decay, whose poles a subspace method (eigensystem realisation) finds without a starting
    guess; the physical parameters are then refined for the least output error of the exactly
    sampled model in its periodic state, with offset and gain of the hysteresis (4.5) and the
    initial creep free.

    Parameters
    ----------
    recording : Recording
        Of the dynamics experiment, at the full sample clock.
    mode_count : int, optional
        Number of vibration modes, one after the other and without antiresonances; by default as
        many of both, and of modes beside them, as the Bayesian information criterion justifies.
    delay : float, optional
        Of the rows, in sample periods; by default it is estimated beside.

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
    return fit_beside_fast_creep(
        lambda known: mean_period(recording, known), creep, mode_count, delay)


def mean_period(recording: Recording, creep: CreepDynamics) -> FastRecord:
    """Return the mean period of a square wave with the creep removed.

    Raises
    ------
    ValueError
        As `estimate_dynamics`.
    """
    part = square_part(played_at_the_clock(recording))
    period_s = part.sample_period_s
    wave = square_wave(part)
    quick_um = remove_creep(part.displacement_um, creep, period_s)
    earliest = int(np.ceil(WARM_UP_S / period_s))
    steps = wave.steps[first_settled_step(quick_um, wave.steps, earliest) :]
    if steps.size < 3:
        raise ValueError(
            f"{recording.path} is too short: record several periods of the dynamics"
        )
    length = steps[2] - steps[0]
    if np.any(steps[2:] - steps[:-2] != length):
        raise ValueError(f"{recording.path} is not periodic: record one square wave throughout")
    runs = (steps[-1] - steps[0]) // length

    def fold(signal: FloatArray) -> FloatArray:
        signal = signal[steps[0] : steps[0] + runs * length]
        return signal.reshape(runs, length, *signal.shape[1:]).mean(axis=0)

    measured_um = fold(quick_um)
    half = steps[1] - steps[0]
    count = min(half, length - half)

    def starts(mode_count: int) -> list[ComplexArray]:
        poles = []
        for skipped in SKIPPED_SAMPLES:
            # Both half periods are one free decay, but for offset and sign.
            decay_um = measured_um[skipped:count] - measured_um[half + skipped : half + count]
            try:
                poles.append(free_decay_poles(decay_um, period_s, 2 * mode_count + 1))
            except ValueError:
                # The half period is too short for as many.
                break
        return poles

    drift = drift_basis(period_s * np.arange(quick_um.size, dtype=float), creep)
    return FastRecord(
        HeldInput(wave.level[steps[0] : steps[0] + length], period_s, is_periodic=True),
        np.arange(length), measured_um, fold(drift), starts)


def free_decay_poles(decay: FloatArray, sample_period_s: float, order: int) -> ComplexArray:
    """Poles (rad/s, complex) of a free decay around an unknown end value.

    The Hankel matrix of the decay has the rank of the system; the shift of its signal subspace has
    the discrete poles as eigenvalues, among them the 1 of the end value, which is dropped.

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
    # Reals come in an even number here, so that the end value's is one of them, or there is none.
    discrete = np.delete(discrete, np.argmin(np.abs(discrete - 1.0) + 2.0 * (discrete.imag != 0.0)))
    # A negative eigenvalue has no continuous pole: a fast one is the nearest there is.
    discrete[discrete.imag == 0.0] = np.abs(discrete[discrete.imag == 0.0])
    return np.log(discrete) / sample_period_s
