# SPDX-License-Identifier: BSD-3-Clause
"""Input and output of the electric and vibration dynamics, of one recording or several."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.creep_removal import remove_creep
from piezo_identification.conditioning.waveforms import played, samples_per_mean
from piezo_identification.estimators.dynamics.fast_record import FastRecord
from piezo_identification.estimators.dynamics.output_error import fit_output_error
from piezo_identification.estimators.estimate import Estimate
from piezo_identification.estimators.poles.pole_responses import HeldInput
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics
from piezo_recorder.reading.recording import Recording

FEWEST_SAMPLES = 160
"""Smallest number of samples of a fast input: fewer give too few spectral lines for a mode."""

LATE_ROWS = 2
"""Number of rows omitted at the end: a row may be read by so much later, under an unknown
voltage."""


@dataclass(frozen=True, eq=False)
class FastSignals:
    """Inputs and measured outputs of the dynamics, with recordings joined one after another."""

    entering_um: FloatArray
    displacement_um: FloatArray
    """Output of the hysteresis, and the displacement without creep, (N,)."""
    drift: FloatArray
    """Offset and possible remains of earlier creep, separately for each recording, (N, K)."""
    kept: NDArray[np.intp]
    """Samples in which the input is fast and the start has settled."""
    begins: tuple[int, ...]
    """First sample of each recording."""
    sample_period_s: float

    early: FloatArray | None = None
    """Fraction of a sample period by which each input precedes its sample, (N,); by default
    zero."""
    phase_room: float = 0.0
    """Fraction of a sample period by which all inputs may be earlier or later."""

    def record(self) -> FastRecord:
        """Return the record that is fitted."""
        return FastRecord(
            HeldInput(self.entering_um, self.sample_period_s, False, self.begins, self.early),
            self.kept, self.displacement_um[self.kept], self.drift[self.kept],
            phase_room=self.phase_room)


def joined_signals(
    parts: Sequence[Recording], inputs_um: Sequence[FloatArray], first_kept: Sequence[int],
    creep: CreepDynamics,
) -> FastSignals:
    """Join recordings one after another, each with its own offset and initial creep.

    Parameters
    ----------
    parts : sequence of Recording
        Results of `played_at_the_clock`, with the same sample period.
    inputs_um : sequence of ndarray
        Input of the dynamics in each recording, in any unit.
    first_kept : sequence of int
        First sample of each recording that is fitted.
    creep : CreepDynamics
        Creep to be removed.

    Raises
    ------
    ValueError
        If the input of the dynamics is constant.
    """
    for part, entering_um in zip(parts, inputs_um, strict=True):
        if np.ptp(entering_um) == 0.0:
            raise ValueError(
                f"{part.path} shows no displacement that rises with the voltage: its sensor counts "
                "down, or it is no recording of the dynamics; give one of the creep or the "
                "hysteresis too, which shows the sign, or change the sign of the displacement")
    sizes = [part.voltage_v.size for part in parts]
    begins = np.cumsum([0, *sizes])
    stretches = [slice(begin + first, begin + size - LATE_ROWS)
                 for begin, first, size in zip(begins, first_kept, sizes, strict=False)]
    blocks = [drift_basis(part.time_s, creep) for part in parts]
    width = blocks[0].shape[1]
    drift = np.zeros((begins[-1], width * len(blocks)))
    for index, block in enumerate(blocks):
        drift[begins[index] : begins[index + 1], index * width : (index + 1) * width] = block
    return FastSignals(
        np.concatenate([np.asarray(each, dtype=float) for each in inputs_um]),
        np.concatenate([
            remove_creep(part.displacement_um, creep, part.sample_period_s) for part in parts]),
        drift, np.concatenate([np.arange(each.start, each.stop) for each in stretches]),
        tuple(begins[:-1].tolist()), parts[0].sample_period_s)


def fit_signals(
    signals: FastSignals, mode_count: int | None = None, delay: float | None = None,
) -> Estimate:
    """Fit the dynamics of least output error behind a known input.

    Parameters
    ----------
    mode_count : int, optional
        By default as many as the Bayesian information criterion justifies.
    delay : float, optional
        Delay of the rows in sample periods; by default it is estimated.
    """
    return fit_output_error(signals.record(), mode_count, delay)


def played_at_the_clock(recording: Recording) -> Recording:
    """Part of a recording in which a waveform plays; averaged recordings are refused.

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


def through_hysteresis(
    recording: Recording, part: Recording, hysteresis: PreisachModel,
) -> FloatArray:
    """Return the input of the dynamics: the output of a hysteresis since the recording started.

    Parameters
    ----------
    part : Recording
        Part of the recording in which the waveform plays.

    Returns
    -------
    ndarray, shape (N,)
        Output during the part.

    Raises
    ------
    ValueError
        If the voltage leaves the range of the hysteresis.
    """
    low_v, high_v = part.voltage_v.min(), part.voltage_v.max()
    slack_v = 1e-6 * (hysteresis.voltage_max_v - hysteresis.voltage_min_v)
    if low_v < hysteresis.voltage_min_v - slack_v or high_v > hysteresis.voltage_max_v + slack_v:
        raise ValueError(
            f"{recording.path} goes from {low_v:g} to {high_v:g} V, the hysteresis is known from "
            f"{hysteresis.voltage_min_v:g} to {hysteresis.voltage_max_v:g} V: identify it over a "
            "wider range")
    memory = hysteresis.memory()
    hysteresis.simulate(
        recording.select(recording.sample_index <= part.sample_index[0]).voltage_v, memory)
    return hysteresis.simulate(part.voltage_v, memory)


def drift_basis(time_s: FloatArray, creep: CreepDynamics) -> FloatArray:
    """Columns (N, K) of what a record without creep may still contain: offset and initial creep."""
    return np.column_stack(
        [np.ones_like(time_s), *(np.exp(-zero * time_s) for zero in creep.zeros_rad_per_s)]
    )
