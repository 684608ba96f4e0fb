# SPDX-License-Identifier: BSD-3-Clause
"""Samples that the sensor got wrong: found, left out of fits and errors, and told of."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from piezo_common.arrays import FloatArray
from piezo_models.effects.isolated_samples import (
    JUMP,
    isolated,
    typical_answer_per_v,
    typical_range,
)
from piezo_models.effects.outliers import FEWEST
from piezo_recorder.reading.recording import Recording

OUTLIER = "outlier_um"
"""Further column of a recording: by how much the displacement was off, where it is not to be used;
zero elsewhere. A CSV file may bring its own, which is taken as it is."""

SMALL = 1e-4
"""Part of the travel that counts as noise, at least."""

MOST_TOLD = 5
"""Places that are told; the others are counted."""


def with_outliers_marked(recording: Recording) -> Recording:
    """Mark the outliers of a recording, and put them among the good samples beside them.

    Estimators that take a mask leave the marked samples out, by `good_samples`; the others use the
    values in their place.

    Parameters
    ----------
    recording : Recording
        Returned as it is where it has the column `OUTLIER`.

    Returns
    -------
    Recording
        With the column `OUTLIER`.
    """
    if OUTLIER in recording.columns:
        return recording
    measured_um = np.array(recording.displacement_um, dtype=float)
    wrong = isolated(measured_um, recording.voltage_v, noise=SMALL * typical_range(measured_um))
    off_um = np.zeros(measured_um.size)
    if np.count_nonzero(wrong) >= FEWEST:
        good = np.flatnonzero(~wrong)
        sample = np.clip(np.flatnonzero(wrong), good[0], good[-1])
        off_um[wrong] = measured_um[wrong] - PchipInterpolator(good, measured_um[good])(sample)
    return replace(recording, displacement_um=measured_um - off_um,
                   columns=recording.columns | {OUTLIER: off_um})


def good_samples(recording: Recording) -> NDArray[np.bool_]:
    """Mark the samples that are not outliers.

    Returns
    -------
    (N,) array of bool
    """
    if OUTLIER not in recording.columns:
        return np.ones(recording.voltage_v.size, dtype=bool)
    return recording.columns[OUTLIER] == 0.0


def outliers_of_residual(
    residual_um: FloatArray, measured_um: FloatArray, voltage_v: FloatArray, noise_um: float = 0.0,
) -> NDArray[np.bool_]:
    """Mark the samples that stand out of the difference from a model.

    Parameters
    ----------
    residual_um, measured_um, voltage_v : (N,) array
    noise_um : float
        Standard deviation of the noise of a sample, at least.

    Returns
    -------
    (N,) array of bool
    """
    # Model and stage may answer a jump at different times: what is left moves as the stage does.
    return isolated(residual_um, voltage_v, typical_answer_per_v(measured_um, voltage_v),
                    max(noise_um, SMALL * typical_range(measured_um)), JUMP)


def outlier_text(path: object, wrong: NDArray[np.bool_], time_s: FloatArray) -> str:
    """Tell people in one sentence how many samples are left out, and where.

    Parameters
    ----------
    wrong : (N,) array of bool
    time_s : (N,) array

    Returns
    -------
    str
        Empty if there are none.
    """
    count = int(np.count_nonzero(wrong))
    if not count:
        return ""
    begins = np.flatnonzero(np.diff(wrong.astype(int), prepend=0) == 1)
    told = ", ".join(f"{time_s[begin]:.6g}" for begin in begins[:MOST_TOLD])
    more = f" and {begins.size - MOST_TOLD} more" if begins.size > MOST_TOLD else ""
    return (f"{path}: {count} of {wrong.size} samples ({100.0 * count / wrong.size:.2g} %) are "
            f"outliers and were left out, at {told} s{more}")
