# SPDX-License-Identifier: BSD-3-Clause
"""The evidence of a model of several axes on all its recordings, and its derivatives.

The function is that of `joint_errors`, with an error of unknown variance for each axis in each
recording. Offsets and what decays from before a recording are projected out. Each axis in each
recording counts as many independent errors as its residual with the initial model: where a model
lacks something, that recurs in long parts of a recording, which must not outweigh the others.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_common.cancellation import check_cancelled
from piezo_common.side_by_side import side_by_side
from piezo_identification.axes.free_axes import FreeAxes
from piezo_identification.axes.predict_axes import (
    Circumstances,
    circumstances_of,
    creep_decays,
    decays,
    simulated_um,
)
from piezo_identification.fitting.clustered_covariance import clustered_covariance
from piezo_identification.fitting.dataset import SPLIT, split_rows
from piezo_identification.fitting.evidence import INDEPENDENT, correlated_scale
from piezo_identification.fitting.joint_errors import SETTINGS
from piezo_identification.fitting.regression import SETTINGS as REGRESSION
from piezo_identification.fitting.whole_model import ADEQUATE
from piezo_models.axes.coupled import CoupledModel
from piezo_recorder.reading.axes import AxesRecording

STEP = 1e-5
"""Step of the numerical derivatives in prior widths: their error is as small, relative."""

ALIKE = 1e-9
"""Singular value of the decays, relative to the largest, below which a direction is rounding."""


@dataclass(frozen=True, eq=False)
class _Part:
    """A recording, how it is simulated, and its rows that are fitted."""

    recording: AxesRecording
    circumstances: Circumstances
    rows: NDArray[np.intp]

    def motion_um(self, model: CoupledModel, voltage_v: FloatArray) -> FloatArray:
        """Return the motion at the rows under some voltages, (r, n)."""
        return simulated_um(model, replace(self.recording, voltage_v=voltage_v),
                            self.circumstances)[self.rows]

    def drive_v(self, model: CoupledModel, axis: int) -> FloatArray:
        """Return the drive of the modes by one axis, (N,)."""
        how, periods = self.circumstances, self.recording.periods or 1
        voltage_v = self.recording.voltage_v[:, axis].reshape(periods, -1).mean(axis=0)
        return np.tile(model.actuators[axis].drive_v(
            voltage_v, self.recording.sample_period_s, bool(self.recording.periods),
            how.pasts[axis], not how.is_held), periods)


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
    """Errors of a model of several axes as a function of changes of its parameters.

    Parameters
    ----------
    free : FreeAxes
        Its parameters.
    recordings : sequence of AxesRecording
        All that are fitted.

    Attributes
    ----------
    low, high, longest : (n,) array
        See `levenberg_marquardt.Objective`.
    """

    def __init__(self, free: FreeAxes, recordings: Sequence[AxesRecording]) -> None:
        self._free = free
        rows, self._stretch, _ = split_rows(
            [each.voltage_v for each in recordings], [0] * len(recordings))
        self._parts = [_Part(each, circumstances_of(free.model, each), at)
                       for each, at in zip(recordings, rows, strict=True)]
        self.low, self.high = free.low, np.full(free.low.size, np.inf)
        self.longest = np.full(free.low.size, SETTINGS.longest)
        self._is_hysteresis = np.isfinite(free.low)
        travel_um = np.array([np.ptp(each.displacement_um, axis=0) for each in recordings])
        self._accuracy_um = ADEQUATE * REGRESSION.model_tolerance * travel_um
        self._points: dict[bytes, list[_Compared]] = {}
        self._of_hysteresis: dict[int, FloatArray] = {}
        self._counts = np.array([[_independent(residual_um) for residual_um in each.residual_um.T]
                                 for each in self._at(np.zeros(free.low.size))])

    def value(self, vector: FloatArray) -> float:
        """Return the function to minimise; infinite where the simulation is not finite."""
        squares = self._squares_um2(vector)
        against = float(0.5 * np.sum(self._counts * np.log(squares)) + 0.5 * vector @ vector)
        return against if np.isfinite(against) else np.inf

    def linearised(self, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the weighted errors and their derivatives, followed by those of the prior."""
        compared = self._at(vector)
        columns = side_by_side(lambda index: self._columns_at(vector, index),
                               range(len(self._parts)))
        residuals, jacobians = [], []
        for each, moved_um, squares, counts in zip(
                compared, columns, self._squares_um2(vector), self._counts, strict=True):
            weight = np.sqrt(counts / (len(each.residual_um) * squares))[:, None]
            residuals.append((weight * each.residual_um.T).ravel())
            jacobians.append((-weight[:, :, None] * moved_um).reshape(-1, vector.size))
        return (np.concatenate([*residuals, vector]),
                np.vstack([*jacobians, np.eye(vector.size)]))

    def covariance(self, vector: FloatArray) -> FloatArray:
        """Return the covariance of the changes, with the prior of the hysteresis alone.

        Errors may be correlated within a stretch of a recording.
        """
        residual, jacobian = self.linearised(vector)
        jacobian[-vector.size:][~self._is_hysteresis] = 0.0
        n, ends = len(self._free.model.axes), np.cumsum([part.rows.size for part in self._parts])
        of_rows = [(number * n + axis) * SPLIT.stretches + stretch % SPLIT.stretches
                   for number, stretch in enumerate(np.split(self._stretch, ends[:-1]))
                   for axis in range(n)]
        return clustered_covariance(jacobian, residual, np.concatenate(of_rows))

    def _squares_um2(self, vector: FloatArray) -> FloatArray:
        """Return mean square error plus squared accuracy by recording and axis, (R, n)."""
        squares = np.array([np.mean(each.residual_um**2, axis=0) for each in self._at(vector)])
        return squares + self._accuracy_um**2

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
        columns = np.zeros((len(free.model.axes), part.rows.size, vector.size))
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
        decaying = creep_decays(model, part.recording, part.rows)
        is_known, n = index in self._of_hysteresis, len(model.axes)
        for axis, places in enumerate(free.of_actuators):
            for place in range(places.start, places.stop):
                if is_known and self._is_hysteresis[place]:
                    continue
                check_cancelled()
                actuators = [*model.actuators]
                actuators[axis] = free.actuator_at(axis, _stepped(vector, place))
                changed = replace(model, actuators=tuple(actuators))
                moved_um = (creep_decays(changed, part.recording, part.rows) - decaying) @ (
                    self._at(vector)[index].crept_um)
                if np.ptp(drive_v[:, axis]) > 0.0:
                    change_v = part.drive_v(changed, axis) - drive_v[:, axis]
                    moved_um += part.motion_um(modes, np.outer(change_v, np.eye(n)[axis]))
                columns[:, :, place] = moved_um.T / STEP
        # What a change of the hysteresis moves hardly depends on the other parameters.
        columns[:, :, self._is_hysteresis] = self._of_hysteresis.setdefault(
            index, columns[:, :, self._is_hysteresis])


def _independent(residual_um: FloatArray) -> float:
    """Return how many independent errors a residual has that is not white, of those that count."""
    square = np.mean((residual_um / correlated_scale(residual_um)) ** 2)
    return float(np.minimum(residual_um.size * square, INDEPENDENT))


def _stepped(vector: FloatArray, place: int) -> FloatArray:
    stepped = vector.copy()
    stepped[place] += STEP
    return stepped


def _compared(part: _Part, model: CoupledModel) -> _Compared:
    left_um = part.recording.displacement_um[part.rows] - part.motion_um(
        model, part.recording.voltage_v)
    courses = decays(model, part.recording, part.rows)
    nuisance, sizes, directions = np.linalg.svd(np.column_stack([
        np.ones(len(courses)), courses]), full_matrices=False)
    kept = sizes > ALIKE * sizes[0]
    nuisance = nuisance[:, kept]
    along = nuisance.T @ left_um
    coefficients = directions[kept].T @ (along / sizes[kept, None])
    crept = sum(len(each.creep.poles_rad_per_s) for each in model.actuators)
    return _Compared(nuisance, coefficients[1:1 + crept], left_um - nuisance @ along)
