# SPDX-License-Identifier: BSD-3-Clause
"""Electric and vibration dynamics from a multi-sine and an identified hysteresis (thesis 3.4.2)."""

from dataclasses import dataclass

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.conditioning.waveforms import slow_branches
from piezo_identification.estimators.dynamics.fast_record import FastRecord
from piezo_identification.estimators.dynamics.output_error import fit_output_error
from piezo_identification.estimators.dynamics.pole_responses import HeldInput
from piezo_identification.estimators.dynamics.square_wave import (
    WARM_UP_S,
    drift_basis,
    played_at_the_clock,
    remove_creep,
)
from piezo_identification.estimators.estimate import Estimate
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics
from piezo_recorder.reading.recording import Recording

LINE_THRESHOLD = 0.02
"""Spectral lines weaker than this part of the strongest do not count as excited."""

LATE_ROWS = 2
"""Rows at the end that are left out, as a row may be read up to so much later."""

LOWEST_LINE = 8
"""First line of a windowed spectrum that the slow parts do not reach."""


def estimate_dynamics_multisine(
    recording: Recording, hysteresis: PreisachModel, creep: CreepDynamics,
    mode_count: int | None = None, delay: float | None = None,
) -> Estimate:
    """Estimate the electric lag and the vibration modes (3.2) from a multi-sine.

    The identified hysteresis tells what enters the dynamics. The inverse response at the excited
    lines is a polynomial in the frequency, which gives a start; the physical parameters are then
    those of least output error.

    Parameters
    ----------
    recording : Recording
        Of the multisine experiment, at the full sample clock: any fast input that comes from
        negative saturation.
    hysteresis : PreisachModel
        Covers the voltages of the recording.
    creep : CreepDynamics
    mode_count : int, optional
        By default as many as the Bayesian information criterion justifies.
    delay : float, optional
        Of the rows, in sample periods; by default it is estimated beside.

    Returns
    -------
    Estimate
        Its model is an `ElectricVibrationDynamics`; its order counts modes. Hysteresis and creep
        are taken for exact in the standard deviations.

    Raises
    ------
    ValueError
        If the recording has gaps, is averaged, leaves the hysteresis' range, or is too short.
    """
    signals = hysteresis_and_displacement(recording, hysteresis, creep)
    # What comes after the last row is not known, and a row may be read late.
    fast = slice(signals.fast.start, signals.fast.stop - LATE_ROWS)

    def starts(count: int) -> list[ComplexArray]:
        try:
            return [_poles_of_lines(signals, 2 * count + 1, recording.path)]
        except ValueError:
            # The lines are too few for as many poles.
            return []

    record = FastRecord(
        HeldInput(signals.hysteresis_um, signals.sample_period_s, is_periodic=False),
        np.arange(fast.start, fast.stop), signals.displacement_um[fast], signals.drift[fast],
        starts)
    return fit_output_error(record, mode_count, delay)


@dataclass(frozen=True)
class FastSignals:
    """Input and output of the electric and vibration dynamics.

    Parameters
    ----------
    hysteresis_um, displacement_um : ndarray, shape (N,)
        What the hysteresis puts in, and the displacement without creep.
    drift : ndarray, shape (N, K)
        Offset and what may be left of earlier creep.
    fast : slice
        Part in which the input is fast.
    sample_period_s : float
    """

    hysteresis_um: FloatArray
    displacement_um: FloatArray
    drift: FloatArray
    fast: slice
    sample_period_s: float


def hysteresis_and_displacement(
    recording: Recording, hysteresis: PreisachModel, creep: CreepDynamics,
) -> "FastSignals":
    """Input and output of the electric and vibration dynamics in a recording.

    Parameters
    ----------
    recording : Recording
    hysteresis : PreisachModel
    creep : CreepDynamics

    Returns
    -------
    FastSignals

    Raises
    ------
    ValueError
        If the recording has gaps, is averaged, leaves the hysteresis' range, or is too short.
    """
    part = played_at_the_clock(recording)
    low_v, high_v = part.voltage_v.min(), part.voltage_v.max()
    slack_v = 1e-6 * (hysteresis.voltage_max_v - hysteresis.voltage_min_v)
    if low_v < hysteresis.voltage_min_v - slack_v or high_v > hysteresis.voltage_max_v + slack_v:
        raise ValueError(
            f"{recording.path} goes from {low_v:g} to {high_v:g} V, the hysteresis is known from "
            f"{hysteresis.voltage_min_v:g} to {hysteresis.voltage_max_v:g} V: identify it over a "
            "wider range"
        )
    memory = hysteresis.memory()
    hysteresis.simulate(
        recording.select(recording.sample_index <= part.sample_index[0]).voltage_v, memory
    )
    slow = np.flatnonzero(slow_branches(part.time_s, part.voltage_v))
    begin = max(slow[-1] + 1 if slow.size else 0, round(WARM_UP_S / part.sample_period_s))
    if part.voltage_v.size - begin < 20 * LOWEST_LINE:
        raise ValueError(
            f"{recording.path} has no fast input after {begin * part.sample_period_s:.3g} s: give "
            "the recording of a multisine experiment"
        )
    return FastSignals(
        hysteresis.simulate(part.voltage_v, memory),
        remove_creep(part.displacement_um, creep, part.sample_period_s),
        drift_basis(part.time_s, creep),
        slice(begin, part.voltage_v.size), part.sample_period_s,
    )


def _poles_of_lines(signals: "FastSignals", order: int, path: str) -> ComplexArray:
    """Poles (rad/s) of a response without zeros through the excited spectral lines."""
    window = np.hanning(signals.hysteresis_um[signals.fast].size)
    inputs, outputs = (
        np.fft.rfft(window * (signal[signals.fast] - signal[signals.fast].mean()))[LOWEST_LINE:]
        for signal in (signals.hysteresis_um, signals.displacement_um)
    )
    lines = np.flatnonzero(np.abs(inputs) > LINE_THRESHOLD * np.abs(inputs).max())
    if 2 * lines.size <= order:
        raise ValueError(
            f"{path} has {lines.size} spectral lines, too few for {order} poles: use more tones"
        )
    inputs, outputs = inputs[lines], outputs[lines]
    rates = 2.0 * np.pi * (lines + LOWEST_LINE) / (window.size * signals.sample_period_s)
    # Held input: half a sample of delay.
    outputs = outputs * np.exp(0.5j * rates * signals.sample_period_s)
    powers = (1j * rates[:, None] / rates[-1]) ** np.arange(order + 1)
    weights = np.ones(lines.size)
    for _ in range(4):
        # The output's noise comes in multiplied by the polynomial, which the weights undo.
        columns, target = (weights * outputs)[:, None] * powers, weights * inputs
        polynomial = np.linalg.lstsq(
            np.vstack([columns.real, columns.imag]),
            np.concatenate([target.real, target.imag]), rcond=None,
        )[0]
        weights = 1.0 / np.abs(powers @ polynomial)
    return np.roots(polynomial[::-1]) * rates[-1]
