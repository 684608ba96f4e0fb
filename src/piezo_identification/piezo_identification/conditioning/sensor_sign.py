# SPDX-License-Identifier: BSD-3-Clause
"""The sign of the sensor; the displacement of models rises with the voltage.

All commands use the same rule. The sign is changed if the displacement moves against a reference
that rises with the voltage: the displacement of the model or, without a model, the voltage. The
correlation of their slowest motion counts as much as that of all motion, as every stage moves
against its voltage above a resonance.
"""

from dataclasses import replace

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.conditioning.outlier_samples import good_samples
from piezo_identification.conditioning.segments import played_segments
from piezo_identification.conditioning.waveforms import played
from piezo_recorder.reading.recording import Recording

SLOWEST = 0.05
"""Fraction of the reference's power, from the lowest frequency on, that is its slowest motion."""


def moves_against(
    displacement_um: FloatArray, reference: FloatArray, free: FloatArray | None = None,
) -> bool:
    """Return whether a displacement moves against a reference, (N,), the slowest motion above all.

    The nuisance regressors `free`, (N, k), by default the mean, are projected out of both.
    """
    free = np.ones((reference.size, 1)) if free is None else free
    both = np.column_stack([displacement_um, reference])
    residuals = both - free @ np.linalg.lstsq(free, both, rcond=1e-12)[0]
    lines = np.fft.rfft(residuals, axis=0)
    power = np.cumsum(np.abs(lines[:, 1]) ** 2)
    slow = lines[: 1 + int(np.searchsorted(power, SLOWEST * power[-1]))]
    return _correlation(*slow.T) + _correlation(*residuals.T) < 0.0


def _correlation(moved: ComplexArray | FloatArray, given: ComplexArray | FloatArray) -> float:
    norms = float(np.linalg.norm(moved) * np.linalg.norm(given))
    return float(np.vdot(given, moved).real) / norms if norms else 0.0


def displacement_falls(recording: Recording) -> bool:
    """Return whether the displacement falls overall as the voltage rises.

    The voltage is slow compared with the vibrations, and the longest stretch of the recording is
    used.
    """
    stretches = played_segments(recording) if recording.gaps else [played(recording)]
    part = max(stretches, key=lambda each: each.voltage_v.size)
    good = good_samples(part)
    return moves_against(part.displacement_um[good], part.voltage_v[good])


def reversed_displacement(recording: Recording) -> Recording:
    """Return the recording with the sign of its displacement changed."""
    return replace(recording, displacement_um=np.negative(recording.displacement_um))


def sign_text(path: object) -> str:
    """Return the message that the sign of the displacement was changed."""
    return f"{path}: the displacement moves against the model: its sign is changed"
