# SPDX-License-Identifier: BSD-3-Clause
"""Predictions of a model of several axes, compared with recordings."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.recording_start import AT_REST
from piezo_models.axes.coupled import CoupledModel
from piezo_models.hysteresis.pasts import PASTS
from piezo_models.measures import e_y_percent
from piezo_recorder.reading.axes import AxesRecording
from piezo_recorder.reading.recording import RecordingError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SAME_PERIOD = 1e-4
"""Relative difference of sample periods up to which they are one: a clock's tolerance."""


@dataclass(frozen=True, eq=False)
class AxesPrediction:
    """Measured and simulated displacement of several axes."""

    axes: tuple[str, ...]

    time_s: FloatArray
    """Shape (N,)."""
    voltage_v: FloatArray
    measured_um: FloatArray
    simulated_um: FloatArray
    """Shape (N, n)."""

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
            residual = measured - simulated
            row[0].plot(self.time_s, measured - measured.mean(), **MEASURED)
            row[0].plot(self.time_s, simulated - simulated.mean(), **MODELLED)
            row[1].plot(self.time_s, residual - residual.mean(), **DIFFERENCE)
            row[0].set_ylabel(f"{axis} (um)")
            row[1].set_ylabel("difference (um)")
        grid[0, 0].legend()
        for below in grid[-1]:
            below.set_xlabel("time (s)")
        return figure


@dataclass(frozen=True)
class Circumstances:
    """What a recording does not say of itself."""

    pasts: tuple[str, ...]
    """For each axis the way by which its first voltage was reached, one of
    `piezo_models.hysteresis.pasts.PASTS`."""
    is_held: bool
    """The voltage of a row is held until the next one, whose displacement answers it. Else the rows
    are samples of a voltage that goes on between them, as where a fast recording was thinned; a
    displacement that is the mean over the row that is held is the same."""


def predict_several_axes(model: CoupledModel, recording: AxesRecording) -> AxesPrediction:
    """Return the prediction of a model for the voltage of a recording, with the measurement.

    A recording of periods is predicted as one that has repeated for long, and one whose first
    voltages are all the same from rest. Any other begins in motion: what the modes still ring by is
    estimated from its displacement, as the offset is. So is the rest of earlier creep in all.

    Raises
    ------
    RecordingError
        If the recording is of other axes or of a shorter sample period.

    Examples
    --------
    >>> import control
    >>> import numpy as np
    >>> from piezo_identification import AxesResponse, identify_several_axes
    >>> from piezo_recorder import axes_recordings_in
    >>> mode = [1e-6, 1e-4, 1.0]
    >>> stage = control.tf([[[1.0], [0.1]], [[0.1], [2.0]]], [[mode, mode], [mode, mode]])
    >>> identified = identify_several_axes(AxesResponse.from_control(
    ...     control.frequency_response(stage, np.geomspace(10.0, 3000.0, 30))), pairs=1)
    >>> time_s = 1e-4 * np.arange(2000)
    >>> voltage_v = np.column_stack([np.sin(100.0 * time_s), np.sin(200.0 * time_s)])
    >>> moved = control.forced_response(stage, time_s, voltage_v.T).outputs
    >>> recording, = axes_recordings_in({
    ...     "time_s": time_s, "x_voltage_v": voltage_v[:, 0], "y_voltage_v": voltage_v[:, 1],
    ...     "x_displacement_um": moved[0], "y_displacement_um": moved[1]})
    >>> prediction = predict_several_axes(identified.model, recording)
    >>> prediction.axes, max(prediction.e_y_percent().values()) < 2.0
    (('x', 'y'), True)
    """
    if recording.axes != model.axes:
        raise RecordingError(f"{recording.name} has the axes {', '.join(recording.axes)}, and the "
                             f"model {', '.join(model.axes)}: give a recording of these")
    if recording.sample_period_s < (1.0 - SAME_PERIOD) * model.sample_period_s:
        raise RecordingError(
            f"{recording.name} has a sample period of {recording.sample_period_s:.6g} s, and the "
            f"model of {model.sample_period_s:.6g} s: resample it, or identify at its rate")
    displacement_um = simulated_um(model, recording, circumstances_of(model, recording))
    displacement_um = displacement_um + fitted(
        decays(model, recording), recording.displacement_um - displacement_um)
    return AxesPrediction(recording.axes, _time_s(recording), recording.voltage_v,
                          recording.displacement_um, displacement_um)


def circumstances_of(model: CoupledModel, recording: AxesRecording) -> Circumstances:
    """Return the circumstances of a recording: the pasts under which a model explains it best.

    Rows that are read late look like a wider hysteresis, so that the model is not asked whether a
    voltage was held between them: it was where it jumps, and the displacement does so a row later.
    """
    is_held = rows_apart(model, recording) == 1.0 or _answers_later(recording)
    n = len(model.axes)
    if recording.periods or not any(each.hysteresis for each in model.actuators):
        return Circumstances(PASTS[:1] * n, is_held)
    residual = [np.std(recording.displacement_um - simulated_um(
        model, recording, Circumstances((past,) * n, is_held)), axis=0) for past in PASTS]
    return Circumstances(tuple(PASTS[best] for best in np.argmin(residual, axis=0)), is_held)


def _answers_later(recording: AxesRecording) -> bool:
    """Return whether the voltage jumps and the displacement follows in the next row."""
    changes, moved = (np.diff(each, axis=0) for each in (
        recording.voltage_v, recording.displacement_um))
    goes_on = np.sum(changes[1:] * changes[:-1]) > 0.5 * np.sum(changes**2)
    later = np.sum(changes[:-1] * moved[1:]) > np.sum(changes[:-1] * moved[:-1])
    return bool(later and not goes_on)


def rows_apart(model: CoupledModel, recording: AxesRecording) -> float:
    """Return the sample periods of the model between rows; 1 where they are one."""
    rows = recording.sample_period_s / model.sample_period_s
    return 1.0 if abs(rows - 1.0) <= SAME_PERIOD else rows


def simulated_um(model: CoupledModel, recording: AxesRecording,
                 circumstances: Circumstances) -> FloatArray:
    """Return the displacement that a model simulates at the rows of a recording, (N, n)."""
    displacement_um = _at_rows(model, recording, circumstances).simulate(
        mean_period(recording, recording.voltage_v), bool(recording.periods), circumstances.pasts,
        not circumstances.is_held)
    return np.tile(displacement_um, (recording.periods or 1, 1))


def driven_v(model: CoupledModel, recording: AxesRecording,
             circumstances: Circumstances) -> FloatArray:
    """Return the drive of the modes under the mean period of a recording, (N, n)."""
    return _at_rows(model, recording, circumstances).drive_v(
        mean_period(recording, recording.voltage_v), bool(recording.periods), circumstances.pasts,
        not circumstances.is_held)


def mean_period(recording: AxesRecording, signal: FloatArray) -> FloatArray:
    """Return the mean period of a signal of all axes; the signal if it does not repeat."""
    if not recording.periods:
        return signal
    mean: FloatArray = signal.reshape(recording.periods, -1, len(recording.axes)).mean(axis=0)
    return mean


def _at_rows(model: CoupledModel, recording: AxesRecording,
             circumstances: Circumstances) -> CoupledModel:
    """Return the model for the sample period of a recording."""
    if rows_apart(model, recording) == 1.0:
        return model
    return model.at_period(recording.sample_period_s, not circumstances.is_held)


def decays(model: CoupledModel, recording: AxesRecording,
           rows: slice | NDArray[np.intp] = slice(None)) -> FloatArray:
    """Return the courses by which motion from before a recording decays, (rows, columns).

    Those of the creep come first.
    """
    crept = creep_decays(model, recording, rows)
    if recording.periods or np.all(np.ptp(recording.voltage_v[:AT_REST], axis=0) == 0.0):
        return crept
    poles = model.poles_rad_per_s
    ringing = np.exp(_time_s(recording)[rows, None] * poles)
    return np.hstack([crept, ringing.real, ringing.imag[:, poles.imag > 0.0]])


def creep_decays(model: CoupledModel, recording: AxesRecording,
                 rows: slice | NDArray[np.intp] = slice(None)) -> FloatArray:
    """Return the courses of the creep of earlier motion, one for each rate, (rows, columns)."""
    rates = [rate for each in model.actuators for rate in each.creep.poles_rad_per_s]
    courses: FloatArray = np.exp(-_time_s(recording)[rows, None] * rates)
    return courses


def fitted(courses: FloatArray, residual_um: FloatArray) -> FloatArray:
    """Return the part of the residual that follows some courses about their means, (N, n)."""
    about = courses - courses.mean(axis=0)
    # Together with an offset, which no error includes.
    columns = np.hstack([about, np.ones((len(about), 1))])
    gains = np.linalg.lstsq(columns, residual_um, rcond=1e-9)[0]
    fitted_um: FloatArray = about @ gains[:-1]
    return fitted_um


def _time_s(recording: AxesRecording) -> FloatArray:
    return recording.sample_period_s * np.arange(len(recording.voltage_v), dtype=float)


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
