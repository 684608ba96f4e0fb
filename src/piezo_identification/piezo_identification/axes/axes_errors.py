# SPDX-License-Identifier: BSD-3-Clause
"""The evidence of a model of several axes on all its recordings, and its derivatives.

The function is that of `joint_errors`, with an error of unknown variance for each axis in each
recording. Offsets and what decays from before a recording are projected out. Each error counts as
many independent ones as the residual with the initial model: where a model lacks something, that
recurs in long parts of a recording, which must not outweigh the others.

Periodic recordings are compared by the spectrum of their mean period, in which each octave has an
error of its own and counts alike. In time, the vibration at the resonances would hide the rest.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_common.cancellation import check_cancelled
from piezo_common.side_by_side import side_by_side
from piezo_identification.axes.actuator_drive import with_actuator
from piezo_identification.axes.free_axes import FreeAxes
from piezo_identification.axes.predict_axes import (
    circumstances_of,
    creep_decays,
    decays,
    mean_period,
    simulated_um,
)
from piezo_identification.axes.spectra import played_lines
from piezo_identification.estimators.dynamics.fast_record import COLLINEAR
from piezo_identification.estimators.estimate import FINEST
from piezo_identification.fitting.clustered_covariance import (
    clustered_covariance,
    jackknife_variances,
    widened,
)
from piezo_identification.fitting.dataset import SPLIT, split_rows
from piezo_identification.fitting.evidence import INDEPENDENT, correlated_scale
from piezo_identification.fitting.joint_errors import LONGEST_STEP
from piezo_identification.fitting.regression import SETTINGS as REGRESSION
from piezo_models.axes.coupled import CoupledModel
from piezo_recorder.reading.axes import AxesRecording

STEP = 1e-5
"""Step of the numerical derivatives in prior widths: their error is as small, relative."""

HYSTERESIS_WIDTH = 0.5
"""Prior width of the changes of the hysteresis, relative to that of `free_parameters`. At 1, small
loops follow what the model lacks; at 0.2, the loops of the slow recordings are explained less."""

LOWEST_BAND = 64
"""Lines of the lowest band of a periodic recording, which determine a variance to a tenth. Each
further band is an octave."""


class _Part:
    """A recording, how it is simulated, and its rows that are fitted, each of which is in a band.

    Those of a periodic recording are the real and imaginary parts of the spectrum of its mean
    period, up to the highest line that is played.
    """

    def __init__(self, recording: AxesRecording, model: CoupledModel,
                 rows: NDArray[np.intp]) -> None:
        self.circumstances = circumstances_of(model, recording)
        self.recording, self._rows = recording, rows
        self.band = np.zeros(rows.size, dtype=int)
        if recording.periods:
            voltage_v = mean_period(recording, recording.voltage_v)
            self.recording = replace(
                recording, voltage_v=voltage_v, periods=1,
                displacement_um=mean_period(recording, recording.displacement_um))
            lines = 1 + np.flatnonzero(played_lines(np.fft.rfft(voltage_v, axis=0)))[-1]
            number = np.arange(1, lines)
            self.band = np.repeat(np.log2(np.maximum(number / LOWEST_BAND, 1.0)).astype(int), 2)
        self.measured_um = self.seen(self.recording.displacement_um)

    def seen(self, signal: FloatArray) -> FloatArray:
        """Return the fitted rows of a signal, (r, columns), whose mean square is as large."""
        if not self.recording.periods:
            return signal[self._rows]
        rows = self.band.size
        lines = np.fft.rfft(signal, axis=0)[1 : 1 + rows // 2] * np.sqrt(2.0 * rows) / len(signal)
        return np.stack([lines.real, lines.imag], axis=1).reshape(rows, -1)

    def motion_um(self, model: CoupledModel, voltage_v: FloatArray) -> FloatArray:
        """Return the rows of the motion under some voltages, (r, n)."""
        return self.seen(simulated_um(model, replace(self.recording, voltage_v=voltage_v),
                                      self.circumstances))

    def drive_v(self, model: CoupledModel, axis: int) -> FloatArray:
        """Return the drive of the modes by one axis, (N,)."""
        how, recording = self.circumstances, self.recording
        return model.actuators[axis].drive_v(
            recording.voltage_v[:, axis], recording.sample_period_s, bool(recording.periods),
            how.pasts[axis], not how.is_held)

    def mean_squares(self, residual_um: FloatArray) -> FloatArray:
        """Return the mean square of each band and axis, (bands, n)."""
        return np.array([np.mean(residual_um[self.band == band] ** 2, axis=0)
                         for band in range(self.band[-1] + 1)])

    def counts(self, residual_um: FloatArray) -> FloatArray:
        """Return how many independent errors count in each band and axis, (bands, n)."""
        if self.recording.periods:
            samples = len(self.recording.voltage_v)
            lines = np.pad(residual_um[::2] + 1j * residual_um[1::2], (
                (1, samples // 2 - len(residual_um) // 2), (0, 0)))
            residual_um = np.fft.irfft(lines, samples, axis=0)[self._rows % samples]
        scale_um = np.apply_along_axis(correlated_scale, 0, residual_um)
        white = residual_um / np.maximum(scale_um, np.finfo(float).tiny)
        bands = self.band[-1] + 1
        return np.tile(np.minimum(np.sum(white**2, axis=0), INDEPENDENT) / bands, (bands, 1))

    def crept(self, model: CoupledModel) -> FloatArray:
        """Return the rows of the courses of earlier creep, (r, rates)."""
        if self.recording.periods:
            return self.seen(creep_decays(model, self.recording))
        return creep_decays(model, self.recording, self._rows)

    def before(self, model: CoupledModel) -> FloatArray:
        """Return the rows of what decays from before, earlier creep first, and of the offset."""
        if self.recording.periods:
            return self.crept(model)
        courses = decays(model, self.recording, self._rows)
        return np.column_stack([courses, np.ones(len(courses))])


@dataclass(frozen=True, eq=False)
class _Compared:
    """A recording compared with a model."""

    nuisance: FloatArray
    """Orthonormal courses of offset and decays, (r, columns)."""
    crept_um: FloatArray
    """Size of each course of earlier creep, (creep rates, n)."""
    residual_um: FloatArray
    """Shape (r, n)."""


class AxesErrors:
    """Errors of a model of several axes in recordings as a function of changes of its parameters.

    For `low`, `high` and `longest`, (n,), see `levenberg_marquardt.Objective`.
    """

    def __init__(self, free: FreeAxes, recordings: Sequence[AxesRecording]) -> None:
        self._free = free
        rows, _, _ = split_rows([each.voltage_v for each in recordings], [0] * len(recordings))
        self._parts = [_Part(each, free.model, at)
                       for each, at in zip(recordings, rows, strict=True)]
        self.low, self.high = free.low, np.full(free.low.size, np.inf)
        self.longest = np.full(free.low.size, LONGEST_STEP)
        self._is_hysteresis = free.is_hysteresis
        self._prior = np.where(self._is_hysteresis, 1.0 / HYSTERESIS_WIDTH, 1.0)
        travel_um = np.array([np.ptp(each.displacement_um, axis=0) for each in recordings])
        # An axis may rest without any noise.
        self._accuracy_um = np.hypot(REGRESSION.adequate_tolerance * travel_um,
                                     FINEST * travel_um.max(axis=0))
        self._points: dict[bytes, list[_Compared]] = {}
        self._of_hysteresis: dict[int, FloatArray] = {}
        self._counts = [part.counts(each.residual_um) for part, each in zip(
            self._parts, self._at(np.zeros(free.low.size)), strict=True)]

    def value(self, vector: FloatArray) -> float:
        """Return the function to minimise; infinite where no stage moves so, or not finitely."""
        if not self._free.is_possible(vector):
            return np.inf
        twice = np.sum((self._prior * vector) ** 2) + sum(
            np.sum(counts * np.log(squares)) for counts, squares in zip(
                self._counts, self._squares_um2(vector), strict=True))
        return 0.5 * float(twice) if np.isfinite(twice) else np.inf

    def linearised(self, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the weighted errors and their derivatives, followed by those of the prior."""
        compared = self._at(vector)
        columns = side_by_side(lambda index: self._columns_at(vector, index),
                               range(len(self._parts)))
        residuals, jacobians = [], []
        for part, each, moved_um, squares, counts in zip(
                self._parts, compared, columns, self._squares_um2(vector), self._counts,
                strict=True):
            rows = np.bincount(part.band)[:, None]
            weight = np.sqrt(counts / (rows * squares))[part.band]
            residuals.append((weight * each.residual_um).T.ravel())
            jacobians.append((-weight.T[:, :, None] * moved_um).reshape(-1, vector.size))
        return (np.concatenate([*residuals, self._prior * vector]),
                np.vstack([*jacobians, np.diag(self._prior)]))

    def covariance(self, vector: FloatArray) -> FloatArray:
        """Return the covariance of the changes, with the prior of the hysteresis alone.

        Errors may be correlated within a stretch of a recording, or recur throughout it: where
        recordings contradict each other, no number is known better than they agree.
        """
        residual, jacobian = self.linearised(vector)
        n = len(self._free.model.axes)
        of_rows = np.concatenate([
            (number * n + axis) * SPLIT.stretches
            + np.arange(part.band.size) * SPLIT.stretches // part.band.size
            for number, part in enumerate(self._parts) for axis in range(n)])
        between = jackknife_variances(jacobian, residual, of_rows // SPLIT.stretches)
        jacobian[-vector.size:][~self._is_hysteresis] = 0.0
        return widened(clustered_covariance(jacobian, residual, of_rows), between)

    def _squares_um2(self, vector: FloatArray) -> list[FloatArray]:
        """Return the mean square error plus squared accuracy of each recording, (bands, n)."""
        return [part.mean_squares(each.residual_um) + accuracy_um**2
                for part, each, accuracy_um in zip(
                    self._parts, self._at(vector), self._accuracy_um, strict=True)]

    def _at(self, vector: FloatArray) -> list[_Compared]:
        """Compare all recordings with the model after some changes; two results are cached."""
        key = vector.tobytes()
        if key not in self._points:
            model = self._free.model_at(vector)
            self._points = dict([*self._points.items()][-1:])
            self._points[key] = side_by_side(lambda part: _compared(part, model), self._parts)
        return self._points[key]

    def _columns_at(self, vector: FloatArray, index: int) -> FloatArray:
        """Return the derivatives of the motion in a recording, (n, r, parameters)."""
        part, free = self._parts[index], self._free
        model, nuisance = free.model_at(vector), self._at(vector)[index].nuisance
        drive_v = np.column_stack([
            part.drive_v(model, axis) for axis in range(len(model.axes))])
        columns = np.zeros((len(free.model.axes), part.band.size, vector.size))
        self._add_actuators(columns, model, vector, index, drive_v)
        for place in range(free.of_poles.start, free.of_poles.stop):
            number = place - free.of_poles.start
            before_um, after_um = (part.motion_um(free.mode_at(number, changes), drive_v)
                                   for changes in (vector, _stepped(vector, place)))
            columns[:, :, place] = (after_um - before_um).T / STEP
        moving = np.flatnonzero(np.ptp(drive_v, axis=0) > 0.0)
        for place in range(free.gain_widths.size):
            if place % drive_v.shape[1] not in moving:
                continue
            moved_um = part.motion_um(free.gain_at(place, vector), drive_v)
            for axis, column in enumerate(columns):
                column[:, free.of_gains.start + axis * free.gain_widths.size + place] = (
                    moved_um[:, axis])
        return columns - nuisance @ (nuisance.T @ columns)

    def _add_actuators(self, columns: FloatArray, model: CoupledModel, vector: FloatArray,
                       index: int, drive_v: FloatArray) -> None:
        """Add the derivatives by the parameters of the actuators to those of a recording."""
        part, free = self._parts[index], self._free
        modes = free.modes_of(free.numbers_at(vector))
        decaying = part.crept(model)
        is_known, n = index in self._of_hysteresis, len(model.axes)
        for axis, places in enumerate(free.of_actuators):
            for place in range(places.start, places.stop):
                if is_known and self._is_hysteresis[place]:
                    continue
                check_cancelled()
                changed = with_actuator(
                    model, axis, free.actuator_at(axis, _stepped(vector, place)))
                moved_um = (part.crept(changed) - decaying) @ self._at(vector)[index].crept_um
                if np.ptp(drive_v[:, axis]) > 0.0:
                    change_v = part.drive_v(changed, axis) - drive_v[:, axis]
                    moved_um += part.motion_um(modes, np.outer(change_v, np.eye(n)[axis]))
                columns[:, :, place] = moved_um.T / STEP
        # What a change of the hysteresis moves hardly depends on the other parameters.
        columns[:, :, self._is_hysteresis] = self._of_hysteresis.setdefault(
            index, columns[:, :, self._is_hysteresis])


def _stepped(vector: FloatArray, place: int) -> FloatArray:
    stepped = vector.copy()
    stepped[place] += STEP
    return stepped


def _compared(part: _Part, model: CoupledModel) -> _Compared:
    left_um = part.measured_um - part.motion_um(model, part.recording.voltage_v)
    nuisance, sizes, directions = np.linalg.svd(part.before(model), full_matrices=False)
    kept = sizes > COLLINEAR * sizes[0]
    nuisance = nuisance[:, kept]
    along = nuisance.T @ left_um
    coefficients = directions[kept].T @ (along / sizes[kept, None])
    crept = sum(len(each.creep.poles_rad_per_s) for each in model.actuators)
    return _Compared(nuisance, coefficients[:crept], left_um - nuisance @ along)
