# SPDX-License-Identifier: BSD-3-Clause
"""Electric and vibration dynamics from a short square wave: vector fit, then output-error fit."""

from collections.abc import Collection

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.creep_removal import remove_creep
from piezo_identification.conditioning.recording_start import square_part
from piezo_identification.conditioning.settled_periods import first_settled_step
from piezo_identification.conditioning.waveforms import square_wave
from piezo_identification.estimators.dynamics.fast_creep import fit_with_fast_creep
from piezo_identification.estimators.dynamics.fast_dynamics import ModeOrder
from piezo_identification.estimators.dynamics.fast_record import FastRecord
from piezo_identification.estimators.dynamics.fast_signals import drift_basis, played_at_the_clock
from piezo_identification.estimators.estimate import Estimate
from piezo_identification.estimators.poles.pole_responses import HeldInput
from piezo_models.linear.dynamics import CreepDynamics
from piezo_recorder.reading.recording import Recording

WARM_UP_S = 0.3
"""Smallest part at the start that is not used, because the approach from rest still affects it."""


def estimate_dynamics(
    recording: Recording, creep: CreepDynamics, mode_count: int | None = None,
    delay: float | None = None, among: Collection[ModeOrder] = (),
) -> Estimate:
    """Estimate electric lag, vibration modes (4.3) and delay from a square wave of short period.

    The creep is removed by its inverse, and the periods are averaged. A vector fit finds initial
    poles. The physical parameters are then fitted for the least output error of the exactly sampled
    model in its periodic state, with offset and gain of the hysteresis (4.5) and the initial creep
    free.

    Parameters
    ----------
    recording : Recording
        Recording of the dynamics experiment, at the full sample clock.
    mode_count : int, optional
        Number of modes in series without antiresonances; by default as many of both, and of
        parallel modes, as the Bayesian information criterion justifies.
    delay : float, optional
        Delay of the rows in sample periods; by default it is estimated.
    among : collection of ModeOrder
        See `output_error.fit_output_error`.

    Returns
    -------
    Estimate
        Its model is an `ElectricVibrationDynamics`; its order counts modes. The standard
        deviations assume exact creep.

    Raises
    ------
    ValueError
        If the recording has gaps, is no square wave, is averaged, or is too short.

    Examples
    --------
    >>> import numpy as np
    >>> from piezo_models import (
    ...     CreepDynamics, ElectricVibrationDynamics, PreisachModel, StageModel)
    >>> from piezo_recorder import recording_of
    >>> line = PreisachModel.line(0.0, 10.0, 2.0)
    >>> mode = ElectricVibrationDynamics(0.0, (1000.0,), (0.02,))
    >>> stage = StageModel(line, CreepDynamics(), mode)
    >>> sample = np.arange(6000)
    >>> voltage_v = np.where(sample % 1000 < 500, 0.0, 10.0)
    >>> estimate = estimate_dynamics(recording_of({
    ...     "time_s": 1e-4 * sample, "voltage_v": voltage_v,
    ...     "displacement_um": stage.simulate(voltage_v, 1e-4)}), CreepDynamics(), mode_count=1)
    >>> print(np.round(estimate.model.mode_frequencies_rad_per_s))
    [1000.]
    """
    return fit_with_fast_creep(
        lambda known: mean_period(recording, known), creep, mode_count, delay, among)


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
    drift = drift_basis(period_s * np.arange(quick_um.size, dtype=float), creep)
    return FastRecord(
        HeldInput(wave.level[steps[0] : steps[0] + length], period_s, is_periodic=True),
        np.arange(length), measured_um, fold(drift))
