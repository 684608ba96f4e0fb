# SPDX-License-Identifier: BSD-3-Clause
"""Find outliers of the sensor, exclude them from fits and errors, and report them."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.waveforms import jumps_of
from piezo_models.effects.isolated_samples import (
    JUMP,
    isolated,
    typical_answer_per_v,
    typical_range,
)
from piezo_models.effects.outliers import FEWEST
from piezo_recorder.reading.plausibility import clipped_ends
from piezo_recorder.reading.recording import Recording

OUTLIER = "outlier_um"
"""Column of a recording with the error of the displacement at outliers, zero elsewhere; NaN where
the sensor is clipped, as the error is unknown there. A column of this name in a CSV file is used
unchanged."""

MOST_JUMPS = 0.1
"""Largest part of the rows that begin a jump between holds."""

SMALL = 1e-4
"""Smallest assumed noise, as a fraction of the travel."""

MOST_LISTED = 5
"""Most outliers listed singly; the others are counted."""


def with_outliers_marked(recording: Recording) -> Recording:
    """Mark the outliers of a recording, and replace them by interpolation between good samples.

    Samples at which the sensor is clipped are marked, too, and keep their value. Estimators that
    accept a mask exclude the marked samples by `good_samples`; the others use the interpolated
    values. A recording that has the column `OUTLIER` is returned unchanged.
    """
    if OUTLIER in recording.columns:
        return recording
    measured_um = np.array(recording.displacement_um, dtype=float)
    wrong = isolated(measured_um, recording.voltage_v, noise=SMALL * typical_range(measured_um))
    off_um, mended_um = np.zeros(measured_um.size), measured_um.copy()
    if np.count_nonzero(wrong) >= FEWEST:
        good = np.flatnonzero(~wrong)
        sample = np.clip(np.flatnonzero(wrong), good[0], good[-1])
        mended_um[wrong] = PchipInterpolator(good, measured_um[good])(sample)
        off_um[wrong] = measured_um[wrong] - mended_um[wrong]
    for _, end_um, _ in clipped_ends(mended_um, recording.voltage_v):
        off_um[mended_um == end_um] = np.nan
    return replace(recording, displacement_um=mended_um,
                   columns=recording.columns | {OUTLIER: off_um})


def with_jump_rows_marked(recording: Recording) -> Recording:
    """Mark the first row of each jump of the voltage, and give it the displacement of the next one.

    A model without dynamics answers a jump at once. A row holds the displacement of the instant at
    which its voltage begins, so that the response is shown by the next row. The recording has
    marked outliers. It is returned unchanged if its voltage jumps in many rows, which are points
    that were measured at rest.
    """
    voltage_v = np.asarray(recording.voltage_v, dtype=float)
    rows = jumps_of(voltage_v)
    rows = rows[rows < voltage_v.size - 1]
    if rows.size > MOST_JUMPS * voltage_v.size:
        return recording
    off_um, displacement_um = recording.columns[OUTLIER].copy(), recording.displacement_um.copy()
    off_um[rows] += displacement_um[rows] - displacement_um[rows + 1]
    displacement_um[rows] = displacement_um[rows + 1]
    return replace(recording, displacement_um=displacement_um,
                   columns=recording.columns | {OUTLIER: off_um})


def without_rows_before(recording: Recording, sample_index: int) -> Recording:
    """Exclude the rows of a recording before an index of the sample clock."""
    off_um = np.where(recording.sample_index < sample_index, np.nan,
                      recording.columns.get(OUTLIER, 0.0))
    return replace(recording, columns={**recording.columns, OUTLIER: off_um})


def good_samples(recording: Recording) -> NDArray[np.bool_]:
    """Mark the samples that are not outliers, (N,)."""
    if OUTLIER not in recording.columns:
        return np.ones(recording.voltage_v.size, dtype=bool)
    return recording.columns[OUTLIER] == 0.0


def outliers_of_residual(
    residual_um: FloatArray, measured_um: FloatArray, voltage_v: FloatArray, noise_um: float = 0.0,
) -> NDArray[np.bool_]:
    """Mark the outliers in the residual of a model, (N,), at a noise of at least `noise_um`."""
    # Model and stage may respond to a jump at different times, which moves the residual.
    return isolated(residual_um, voltage_v, typical_answer_per_v(measured_um, voltage_v),
                    max(noise_um, SMALL * typical_range(measured_um)), JUMP)


def outlier_text(path: object, wrong: NDArray[np.bool_], time_s: FloatArray) -> str:
    """Return a sentence on the number and times of excluded samples; empty if there are none."""
    count = int(np.count_nonzero(wrong))
    if not count:
        return ""
    begins = np.flatnonzero(np.diff(wrong.astype(int), prepend=0) == 1)
    listed = ", ".join(f"{time_s[begin]:.6g}" for begin in begins[:MOST_LISTED])
    more = f" and {begins.size - MOST_LISTED} more" if begins.size > MOST_LISTED else ""
    return (f"{path}: {count} of {wrong.size} samples ({100.0 * count / wrong.size:.2g} %) are "
            f"outliers or clipped, and were left out, at {listed} s{more}")
