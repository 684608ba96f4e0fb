# SPDX-License-Identifier: BSD-3-Clause
"""What a model of several axes says beside what recordings measured."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.settling import AT_REST
from piezo_models.axes.coupled import CoupledModel
from piezo_models.measures import e_y_percent
from piezo_recorder.reading.axes import AxesRecording
from piezo_recorder.reading.recording import RecordingError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SAME_PERIOD = 1e-4
"""Relative difference of sample periods up to which they are one: a clock's tolerance."""


@dataclass(frozen=True, eq=False)
class AxesPrediction:
    """Measured and simulated displacement of several axes.

    Attributes
    ----------
    axes : tuple of str
    time_s : (N,) array
    voltage_v, measured_um, simulated_um : (N, n) array
    """

    axes: tuple[str, ...]
    time_s: FloatArray
    voltage_v: FloatArray
    measured_um: FloatArray
    simulated_um: FloatArray

    def e_y_percent(self) -> dict[str, float]:
        """Return the relative error (4.20) of each axis that moves, offset removed."""
        return {axis: e_y_percent(measured, simulated) for axis, measured, simulated in zip(
            self.axes, self.measured_um.T, self.simulated_um.T, strict=True)
            if np.ptp(measured) > 0.0}

    def plot(self) -> "Figure":
        """Draw measured and simulated displacement of each axis, and their difference."""
        from piezo_common.picture_style import DIFFERENCE, MEASURED, MODELLED, WIDE_IN, new_figure

        figure = new_figure(WIDE_IN, 2.0 * len(self.axes))
        grid = figure.subplots(len(self.axes), 2, sharex=True, squeeze=False)
        for number, (axis, row) in enumerate(zip(self.axes, grid, strict=True)):
            measured, simulated = self.measured_um[:, number], self.simulated_um[:, number]
            left = measured - simulated
            row[0].plot(self.time_s, measured - measured.mean(), **MEASURED)
            row[0].plot(self.time_s, simulated - simulated.mean(), **MODELLED)
            row[1].plot(self.time_s, left - left.mean(), **DIFFERENCE)
            row[0].set_ylabel(f"{axis} (um)")
            row[1].set_ylabel("difference (um)")
        grid[0, 0].legend()
        for below in grid[-1]:
            below.set_xlabel("time (s)")
        return figure


def predict_several_axes(model: CoupledModel, recording: AxesRecording) -> AxesPrediction:
    """Return what a model predicts from the voltage of a recording, beside what it measured.

    A recording of periods is predicted as one that has repeated for long, and one whose first
    voltages are all the same from rest. Any other begins in motion: what the modes still ring by is
    estimated from its displacement, as the offset is.

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
    if recording.periods:
        samples = len(recording.voltage_v) // recording.periods
        mean_v = recording.voltage_v.reshape(recording.periods, samples, -1).mean(axis=0)
        simulated_um = np.tile(model.simulate(mean_v, periodic=True), (recording.periods, 1))
    else:
        simulated_um = model.simulate(recording.voltage_v)
        if np.any(np.ptp(recording.voltage_v[:AT_REST], axis=0) > 0.0):
            simulated_um = simulated_um + _begun_um(model, recording.displacement_um - simulated_um)
    return AxesPrediction(
        recording.axes, recording.sample_period_s * np.arange(len(simulated_um), dtype=float),
        recording.voltage_v, recording.displacement_um, simulated_um)


def _begun_um(model: CoupledModel, left_um: FloatArray) -> FloatArray:
    """Return the part of what is left that the modes ring by from before a recording, (N, n)."""
    steps = np.exp(model.poles_rad_per_s * model.sample_period_s)
    decays = steps ** np.arange(len(left_um))[:, None]
    ringing = np.hstack([decays.real, decays.imag[:, steps.imag > 0.0]])
    # Beside an offset, which no error has.
    columns = np.hstack([ringing, np.ones((len(left_um), 1))])
    gains = np.linalg.lstsq(columns, left_um, rcond=1e-9)[0]
    begun_um: FloatArray = ringing @ gains[:-1]
    return begun_um


def errors_percent(model: CoupledModel,
                   recordings: Sequence[AxesRecording]) -> dict[str, dict[str, float]]:
    """Return the mean e_y (4.20) of each axis over recordings, as ``{"x": {"e_y_percent": ...}}``.

    An axis that rests in all of them has none.
    """
    found: dict[str, list[float]] = {}
    for recording in recordings:
        for axis, error in predict_several_axes(model, recording).e_y_percent().items():
            found.setdefault(axis, []).append(error)
    return {axis: {"e_y_percent": float(np.mean(errors))} for axis, errors in found.items()}
