# SPDX-License-Identifier: BSD-3-Clause
"""Plan the voltages that follow a path of several axes, or say which size and rate they can."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piezo_common.arrays import FloatArray
from piezo_common.summary_table import SummaryTable
from piezo_controller.axes.coupled_inverse import GAIN_LIMIT, invert_path
from piezo_controller.axes.path_marks import lead_samples
from piezo_controller.axes.path_prediction import PathPrediction, predict_path
from piezo_controller.axes.repeated_period import faded_in
from piezo_controller.axes.scan_path import MOST_SAMPLES, ScanPath, size_text
from piezo_controller.axes.stored_scan import SAME_PERIOD, stored_scan
from piezo_controller.feedforward.feasibility import (
    Infeasible,
    UnreachableReference,
    check_range,
    check_slew,
    largest_part,
    rounded_down,
)
from piezo_controller.references.kind import InvalidReference
from piezo_models.axes.coupled import CoupledModel
from piezo_models.axes.identified_axes import IdentifiedAxes
from piezo_recorder.images.scan_frame import FORMAT, VERSION, ScanFrame
from piezo_recorder.sample_block import Mark

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SLEW_LIMIT_V_PER_S = 2e6
"""Slew limit, as that of `plan_feedforward`."""


class UnreachablePath(UnreachableReference):
    """A path that voltage range or slew limit do not allow, with what is in reach.

    `reachable_size_um`, (m,), is the largest size in reach at this rate, with zeros where the
    centre is out of reach; `reachable_rate_hz` the largest rate in reach that was found at this
    size, 0 where there is none.
    """

    def __init__(self, message: str, reachable_size_um: FloatArray,
                 reachable_rate_hz: float) -> None:
        super().__init__(message, float(reachable_size_um.max()))
        self.reachable_size_um = reachable_size_um
        self.reachable_rate_hz = reachable_rate_hz


@dataclass(frozen=True, eq=False)
class PathPlan:
    """Voltages of one period of a path, to be repeated."""

    path: ScanPath
    """Path of all axes of the model; an axis that does not move stays at the operating point."""
    model: CoupledModel

    voltage_v: FloatArray
    """Each held for a sample period, (N, n)."""
    left_out_um: FloatArray
    """RMS of what the limit of the gain takes from the path, (n,)."""
    amplitude_v: float
    """RMS of the voltages about the operating point, at which a model that softens was inverted."""
    gain_limit: float
    sensor_delay_s: FloatArray
    """By how much the reading of each axis is late, (n,)."""

    identified: IdentifiedAxes | None = None
    """Knows how far the model may be off."""

    def __repr__(self) -> str:
        return f"<PathPlan: {self.path}, {len(self.voltage_v)} samples>"

    def without_inverse(self) -> "PathPlan":
        """Return the plan of the same path with the static gain of each axis alone."""
        return replace(self, voltage_v=invert_path(
            self.path.position_um, self.model, "none", self.gain_limit).voltage_v)

    @property
    def begin_voltage_v(self) -> FloatArray:
        """Return the voltages from the operating point to the period's first sample, (B, n)."""
        return faded_in(self.voltage_v, self.model)

    @property
    def marks(self) -> NDArray[np.int64]:
        """Return the marks of the samples, (N,): earlier than those of the path by the delay.

        The path is that of the readings; see `lead_samples`.
        """
        path = self.path
        return np.roll(path.marks, -lead_samples(
            path.position_um, path.marks, self.sensor_delay_s / path.sample_period_s))

    @property
    def frame(self) -> ScanFrame | None:
        """Return the pixels of the image; None if the path has no marks of pixels."""
        path = self.path
        marked, lines = (int(np.sum(path.marks & mark > 0)) for mark in (Mark.PIXEL, Mark.LINE))
        if not marked:
            return None
        moved_um = np.abs(np.gradient(path.position_um, axis=0))
        both, centre_um = np.sort(np.argsort(-moved_um.sum(axis=0), kind="stable")[:2]), (
            path.centre_um)
        if path.kind == "raster":  # lines run along the axis that moves at the pixels
            at_pixels_um = moved_um[path.marks & Mark.PIXEL > 0].sum(axis=0)
            both = both[np.argsort(-at_pixels_um[both], kind="stable")]
            pixels = np.array([marked // lines, lines])
            pixel_um = path.size_um[both] / (pixels - [0, 1])
        elif path.kind == "file" and lines > 1 and marked >= 2 * lines:
            at_um = path.position_um[path.marks & Mark.PIXEL > 0]
            both = both[np.argsort(-np.abs(np.diff(at_um, axis=0)).sum(axis=0)[both])]
            pixels = np.array([marked // lines, lines])
            pixel_um = np.ptp(at_um, axis=0)[both] / (pixels - 1)
            centre_um = 0.5 * (at_um.min(axis=0) + at_um.max(axis=0))
        else:
            pixels = np.full(2, round(np.sqrt(marked)))
            pixel_um = path.size_um[both] / pixels
        return ScanFrame(
            format=FORMAT, version=VERSION, path=str(path), marked_pixels=marked,
            axes=[path.axes[axis] for axis in both], pixels=pixels.tolist(),
            pixel_um=pixel_um.tolist(), centre_um=centre_um[both].tolist(),
            sensor_delay_s=self.sensor_delay_s[both].tolist())

    @cached_property
    def prediction(self) -> PathPrediction:
        """Return what the axes do, by the model in the time domain; see `predict_path`."""
        return predict_path(self.path, self.model, self.voltage_v, self.gain_limit,
                            self.identified)

    def summary(self) -> SummaryTable:
        """Return the errors and the cross-coupling to expect as a table with notes."""
        return self.prediction.summary(str(self.path), (
            *self._voltages(),
            f"the gain is limited to {self.gain_limit:g} times that at rest: it omits "
            f"{self.left_out_um.max():.2g} um RMS at most"))

    def _voltages(self) -> Iterator[str]:
        slew = np.abs(np.diff(self.voltage_v, axis=0, append=self.voltage_v[:1])).max(axis=0)
        for axis, low, high, step in zip(self.path.axes, self.voltage_v.min(axis=0),
                                         self.voltage_v.max(axis=0), slew, strict=True):
            yield (f"{axis}: {low:.4g} to {high:.4g} V, at most "
                   f"{step / self.path.sample_period_s:.3g} V/s")

    def plot(self) -> "Figure":
        """Draw the path as commanded and as the axes do it, the error and the voltages."""
        from piezo_controller.axes.path_picture import path_figure

        return path_figure(self)

    def columns(self) -> dict[str, FloatArray]:
        """Return the period as the columns of a table of several axes, with its marks."""
        return stored_scan(self).columns()


def plan_path(path: ScanPath, model: CoupledModel | IdentifiedAxes,
              voltage_range_v: ArrayLike | None = None,
              slew_limit_v_per_s: float = SLEW_LIMIT_V_PER_S,
              gain_limit: float = GAIN_LIMIT,
              sensor_delay_s: ArrayLike | None = None) -> PathPlan:
    """Plan the voltages that make a model of several axes follow a periodic path.

    The path is one of some axes of the model, at its sample period. The voltage range, of all axes
    or of each, (2,) or (n, 2), is by default that of the identification; a model that knows none
    has no limit. The delay by which the reading of each axis is late, (n,), is by default that of
    the model.

    Raises `UnreachablePath`, which names the largest size and rate in reach, if a voltage would
    leave its range or change too fast, and `InvalidReference` if the path does not fit the model.
    """
    coupled = model.model if isinstance(model, IdentifiedAxes) else model
    n = len(coupled.axes)
    if voltage_range_v is None:
        voltage_range_v = (model.voltage_range_v if isinstance(model, IdentifiedAxes)
                           else (-np.inf, np.inf))
    planner = _Planner(
        coupled, np.broadcast_to(np.asarray(voltage_range_v, dtype=float), (n, 2)),
        slew_limit_v_per_s, gain_limit,
        _sensor_delays(model) if sensor_delay_s is None else np.asarray(sensor_delay_s, float),
        model if isinstance(model, IdentifiedAxes) else None)
    whole = _of_all_axes(path, coupled)
    try:
        return planner.plan(whole)
    except Infeasible as reason:
        raise planner.refusal(whole, reason) from None


def _sensor_delays(model: CoupledModel | IdentifiedAxes) -> FloatArray:
    """Return the delays that a model knows; whole samples if no mode showed them.

    Identified delays contain the lag of the electronics. Real poles that are faster than all modes
    are taken for the amplifiers, in front of the modes.
    """
    coupled = model.model if isinstance(model, IdentifiedAxes) else model
    late_s: FloatArray = np.asarray(coupled.latency_samples) * coupled.sample_period_s
    if isinstance(model, IdentifiedAxes):
        late_s = np.where(np.isfinite(model.delay_deviations_s), model.delays_s, late_s)
    poles = coupled.poles_rad_per_s
    highest = np.abs(poles[poles.imag != 0.0]).max(initial=0.0)
    fast = poles.real[(poles.imag == 0.0) & (-poles.real > highest)]
    return np.maximum(late_s - np.sum(-1.0 / fast), 0.0)


def _of_all_axes(path: ScanPath, model: CoupledModel) -> ScanPath:
    unknown = [axis for axis in path.axes if axis not in model.axes]
    if unknown:
        raise InvalidReference(f"the path moves {', '.join(unknown)}, and the model has the axes "
                               f"{', '.join(model.axes)}: name those")
    if abs(path.sample_period_s / model.sample_period_s - 1.0) > SAME_PERIOD:
        raise InvalidReference(
            f"the path has {1.0 / path.sample_period_s:.6g} samples a second, and the model "
            f"{1.0 / model.sample_period_s:.6g}: draw it at the rate of the model")
    at = [model.axes.index(axis) for axis in path.axes]
    n = len(model.axes)
    position_um = np.tile(model.operating_displacement_um, (len(path.position_um), 1))
    position_um[:, at] = path.position_um
    size_um, centre_um = np.zeros(n), model.operating_displacement_um.copy()
    size_um[at], centre_um[at] = path.size_um, path.centre_um
    return ScanPath(path.kind, model.axes, path.sample_period_s, position_um, path.marks,
                    path.rate_hz, size_um, centre_um)


@dataclass(frozen=True)
class _Planner:
    """Plans paths for one model within its limits, and seeks what is in reach."""

    model: CoupledModel
    voltage_range_v: FloatArray
    slew_limit_v_per_s: float
    gain_limit: float
    sensor_delay_s: FloatArray
    identified: IdentifiedAxes | None

    def plan(self, path: ScanPath) -> PathPlan:
        """Plan one path; raise `Infeasible`."""
        found = invert_path(path.position_um, self.model, gain_limit=self.gain_limit)
        self._check_ranges(found.voltage_v)
        for column in found.voltage_v.T:
            check_slew(np.append(column, column[0]), path.sample_period_s,
                       self.slew_limit_v_per_s)
        return PathPlan(path, self.model, found.voltage_v,
                        np.sqrt(np.mean(found.missed_um**2, axis=0)), found.amplitude_v,
                        self.gain_limit, self.sensor_delay_s, self.identified)

    def _check_ranges(self, voltage_v: FloatArray) -> None:
        for axis, column, (low, high) in zip(self.model.axes, voltage_v.T, self.voltage_range_v,
                                             strict=True):
            check_range(column, low, high, (f"{axis} voltages", "V"))

    def refusal(self, path: ScanPath, reason: Infeasible) -> UnreachablePath:
        """Make the refusal that names the largest size and rate in reach."""
        if not self._allows(path.scaled(0.0)):
            return UnreachablePath(
                f"the voltages cannot hold the centre of the path: {reason}; choose another centre",
                np.zeros(len(path.axes)), 0.0)
        inside = largest_part(lambda part: self._allows(path.scaled(part)))
        reachable_um = np.array([rounded_down(inside * each) for each in path.size_um])
        rate_hz = self._reachable_rate_hz(path)
        rate = f"{rate_hz:.6g} Hz at this size" if rate_hz else "no rate at this size"
        return UnreachablePath(
            f"the axes cannot follow the {path}: {reason}; within reach are "
            f"{size_text(reachable_um)} at this rate, and {rate}", reachable_um, rate_hz)

    def _reachable_rate_hz(self, path: ScanPath) -> float:
        """Return the largest rate found, of whole samples; 0 where there is none."""
        at_rest = self.model.response(0.0)[0].real
        offset_um = path.position_um - self.model.operating_displacement_um
        try:
            self._check_ranges(
                self.model.operating_voltage_v + np.linalg.solve(at_rest, offset_um.T).T)
        except Infeasible:  # however slow
            return 0.0
        before = len(path.position_um)
        per_cycle = max(round(1.0 / (path.rate_hz * path.sample_period_s)), 1)

        def slower(each: int) -> ScanPath:
            return path.slower(round(before * each / per_cycle))

        outside, inside = per_cycle, 2 * per_cycle
        while not self._allows(slower(inside)):
            outside, inside = inside, 2 * inside
            if before * inside > MOST_SAMPLES * per_cycle:
                return 0.0
        while inside - outside > 1:
            middle = (inside + outside) // 2
            inside, outside = (middle, outside) if self._allows(slower(middle)) else (
                inside, middle)
        return slower(inside).rate_hz

    def _allows(self, path: ScanPath) -> bool:
        try:
            self.plan(path)
        except Infeasible:
            return False
        return True
