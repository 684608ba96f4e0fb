# SPDX-License-Identifier: BSD-3-Clause
"""Input and output of the electric and vibration dynamics, of one recording or several."""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import block_diag

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.creep_removal import remove_creep
from piezo_identification.conditioning.waveforms import played, samples_per_mean
from piezo_identification.estimators.dynamics.fast_record import FastRecord
from piezo_identification.estimators.poles.pole_responses import HeldInput
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics
from piezo_recorder.reading.recording import Recording

FEWEST_SAMPLES = 160
"""Smallest number of samples of a fast input: fewer give too few spectral lines for a mode."""

LATE_ROWS = 2
"""Number of rows omitted at the end: a row may be read by so much later, under an unknown
voltage."""


def joined_record(
    parts: Sequence[Recording], inputs_um: Sequence[FloatArray], first_kept: Sequence[int],
    creep: CreepDynamics,
) -> FastRecord:
    """Join recordings one after another, each with its own offset and initial creep.

    The parts are results of `played_at_the_clock`, with the same sample period. Each has an input
    of the dynamics, in any unit, and a first sample that is fitted. Raise ValueError if an input is
    constant.
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
    drift = block_diag(*(drift_basis(part.time_s, creep) for part in parts))
    displacement_um = np.concatenate([
        remove_creep(part.displacement_um, creep, part.sample_period_s) for part in parts])
    kept = np.concatenate([np.arange(each.start, each.stop) for each in stretches])
    return FastRecord(
        HeldInput(np.concatenate([np.asarray(each, dtype=float) for each in inputs_um]),
                  parts[0].sample_period_s, False, tuple(begins[:-1].tolist())),
        kept, displacement_um[kept], drift[kept])


def played_at_the_clock(recording: Recording) -> Recording:
    """Return the part of a recording in which a waveform plays.

    Raise ValueError if samples are missing, or are means over several.
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

    Raise ValueError if the voltage leaves the range of the hysteresis.
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
