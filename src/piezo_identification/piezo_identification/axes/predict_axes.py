# SPDX-License-Identifier: BSD-3-Clause
"""What a model of several axes says beside what recordings measured."""

from collections.abc import Sequence

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_models.axes.coupled import CoupledModel
from piezo_models.measures import e_y_percent
from piezo_recorder.reading.axes import AxesRecording
from piezo_recorder.reading.recording import RecordingError

SAME_PERIOD = 1e-4
"""Relative difference of sample periods up to which they are one: a clock's tolerance."""


def predicted_um(model: CoupledModel, recording: AxesRecording) -> FloatArray:
    """Return the displacement that a model predicts from the voltage of a recording, (N, n).

    Raises
    ------
    RecordingError
        If the recording is of other axes or another sample period.
    """
    if recording.axes != model.axes:
        raise RecordingError(f"{recording.name} has the axes {', '.join(recording.axes)}, and the "
                             f"model {', '.join(model.axes)}: give a recording of these")
    if abs(recording.sample_period_s / model.sample_period_s - 1.0) > SAME_PERIOD:
        raise RecordingError(
            f"{recording.name} has a sample period of {recording.sample_period_s:.6g} s, and the "
            f"model of {model.sample_period_s:.6g} s: resample it, or identify at its rate")
    if not recording.periods:
        return model.simulate(recording.voltage_v)
    samples = len(recording.voltage_v) // recording.periods
    mean_v = recording.voltage_v.reshape(recording.periods, samples, -1).mean(axis=0)
    return np.tile(model.simulate(mean_v, periodic=True), (recording.periods, 1))


def errors_percent(model: CoupledModel,
                   recordings: Sequence[AxesRecording]) -> dict[str, dict[str, float]]:
    """Return the mean e_y (4.20) of each axis over recordings, as ``{"x": {"e_y_percent": ...}}``.

    An axis that rests in all of them has none.
    """
    by_axis: dict[str, list[float]] = {axis: [] for axis in model.axes}
    for recording in recordings:
        found = predicted_um(model, recording)
        for number, axis in enumerate(model.axes):
            measured = recording.displacement_um[:, number]
            if np.ptp(measured) > 0.0:
                by_axis[axis].append(e_y_percent(measured, found[:, number]))
    return {axis: {"e_y_percent": float(np.mean(found))} for axis, found in by_axis.items()
            if found}
