# SPDX-License-Identifier: BSD-3-Clause
"""A path planned by `scan`: play it on the stage, and evaluate how well the axes followed it."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from piezo_client.paths import AnyPath
from piezo_client.results import Played
from piezo_common.arrays import FloatArray
from piezo_common.schema import load_document
from piezo_common.summary_table import SummaryTable
from piezo_recorder.images.scan_frame import SCAN_FILE, ScanFrame
from piezo_recorder.reading.axes import read_axes
from piezo_recorder.reading.detected import mark_columns
from piezo_recorder.reading.waveform_file import read_waveform

if TYPE_CHECKING:
    from piezo_controller.axes.path_plan import PathPlan
    from piezo_recorder.images.scan_image import ScanImage

PERIOD_FILE, BEGIN_FILE = "path.csv", "begin.csv"
"""Files of `scan`: one period to repeat, and the way from the operating point into it."""


MAX_FEEDBACK_V = 20.0
"""Largest voltage of a feedback by default, as that of the controller node."""


@dataclass(frozen=True, eq=False)
class StoredScan:
    """The voltages of a planned path, and its positions."""

    axes: tuple[str, ...]
    sample_period_s: float

    begin_voltage_v: FloatArray
    """Voltages of the way into the path, (B, n)."""
    voltage_v: FloatArray
    position_um: FloatArray
    """Voltages and positions of one period, (N, n)."""
    marks: NDArray[np.uint8] = field(default_factory=lambda: np.empty(0, np.uint8))
    """Marks of one period, (N,); empty if there are none."""
    frame: ScanFrame | None = None
    """Pixels of the image; None if no pixels are marked."""

    def repeated_marks(self, periods: int) -> NDArray[np.uint8]:
        """Return the marks of the voltages of `repeated_v`, (T,)."""
        before = np.zeros(len(self.begin_voltage_v), np.uint8)
        return np.concatenate([before, *[self.marks] * periods]) if self.marks.size else self.marks

    def repeated_v(self, periods: int) -> FloatArray:
        """Return the voltages of the way into the path and of some periods of it, (T, n)."""
        return np.concatenate([self.begin_voltage_v, *[self.voltage_v] * periods])


def stored_scan(plan: "PathPlan") -> StoredScan:
    """Return the voltages of a plan, as `read_scan` does from its files."""
    return StoredScan(plan.path.axes, plan.path.sample_period_s, plan.begin_voltage_v,
                      plan.voltage_v, plan.path.position_um, plan.marks.astype(np.uint8),
                      plan.frame)


def read_scan(directory: AnyPath) -> StoredScan:
    """Read the voltages that `scan` wrote into a folder.

    Raises
    ------
    ValueError
        If a file is missing, or the two files do not belong together.
    """
    folder = Path(directory)
    period, = read_axes(folder / PERIOD_FILE)
    begin = read_waveform(folder / BEGIN_FILE)
    if begin.axes != period.axes:
        raise ValueError(f"{folder}: {BEGIN_FILE} and {PERIOD_FILE} have not the same axes: "
                         "plan the scan again")
    described = folder / SCAN_FILE
    frame = load_document(ScanFrame, described) if described.exists() else None
    return StoredScan(period.axes, begin.sample_period_s, begin.voltage_v, period.voltage_v,
                      period.displacement_um, period.marks, frame)


def images_of(run: "Scanned", periods: int, name: str, signal: str = "") -> "dict[str, ScanImage]":
    """Return the images of a run, by the commanded positions and by the measured ones.

    Parameters
    ----------
    name : str
        What the run is; begins the names of the images.

    Raises
    ------
    ValueError
        If the recording has no signal, or the scan no pixels.
    """
    # Imported here, since SciPy takes as long as all that drives a stage.
    from piezo_recorder.images.scan_image import image_of

    recording, = read_axes(run.path)
    scan = run.scan
    commanded_um = np.concatenate([
        np.repeat(scan.position_um[:1], len(scan.begin_voltage_v), axis=0),
        *[scan.position_um] * periods])
    # A recording may go on for some samples of the last voltage.
    behind = len(recording.voltage_v) - len(commanded_um)
    commanded_um = np.pad(commanded_um, ((0, max(behind, 0)), (0, 0)), "edge")
    return {f"{name}, as commanded": image_of(recording, signal, position_um=commanded_um),
            f"{name}, as measured": image_of(recording, signal)}


def write_scan(scan: StoredScan, directory: AnyPath) -> None:
    """Write voltages and positions into a folder, in the format of `scan`, for `read_scan`."""
    folder = Path(directory)
    folder.mkdir(parents=True, exist_ok=True)
    for name, signals in ((PERIOD_FILE, {"voltage_v": scan.voltage_v,
                                         "displacement_um": scan.position_um}),
                          (BEGIN_FILE, {"voltage_v": scan.begin_voltage_v})):
        columns = {"time_s": scan.sample_period_s * np.arange(len(signals["voltage_v"]))} | {
            f"{axis}_{signal}": column for signal, values in signals.items()
            for axis, column in zip(scan.axes, values.T, strict=True)}
        if name == PERIOD_FILE and scan.marks.size:
            columns |= mark_columns(scan.marks)
        np.savetxt(folder / name, np.column_stack(list(columns.values())), "%.9g", ",",
                   header=",".join(columns), comments="")
    if scan.frame is not None:
        (folder / SCAN_FILE).write_text(scan.frame.model_dump_json(indent=1), encoding="utf-8")


@dataclass(frozen=True)
class Scanned(Played):
    """A path that was played.

    Attributes
    ----------
    path : Path
        Path of the recording.
    displacement_um : (N, n) array
        Displacement measured in the last period.
    """

    scan: StoredScan
    displacement_um: FloatArray

    @property
    def offset_um(self) -> FloatArray:
        """Return the mean of the displacement minus that of the path, (n,)."""
        offset_um: FloatArray = (self.displacement_um - self.scan.position_um).mean(axis=0)
        return offset_um

    @property
    def error_um(self) -> FloatArray:
        """Return the displacement minus the path, without the offset, (N, n)."""
        return self.displacement_um - self.scan.position_um - self.offset_um

    @property
    def error_percent(self) -> FloatArray:
        """Return the RMS error (2.32) without the offset, in percent of the axis' travel, (n,).

        For an axis that rests it is relative to the largest travel.
        """
        travel_um = np.ptp(self.scan.position_um, axis=0)
        travel_um = np.where(travel_um > 0.0, travel_um, travel_um.max())
        percent: FloatArray = 100.0 * np.std(self.error_um, axis=0) / travel_um
        return percent

    def summary(self) -> SummaryTable:
        """Return the error of each axis as a table."""
        return SummaryTable(
            f"Last period of {self.path}",
            ("", "travel, um", "error, %", "largest error, um", "offset, um"),
            [(axis, *map(float, numbers)) for axis, *numbers in zip(
                self.scan.axes, np.ptp(self.scan.position_um, axis=0), self.error_percent,
                np.abs(self.error_um).max(axis=0), self.offset_um, strict=True)],
            ("error: RMS by the sensor over the travel (2.32), offset removed",))


def scanned(scan: StoredScan, played: Played, periods: int, before: int = 0) -> Scanned:
    """Return how the last of the periods was followed.

    Parameters
    ----------
    before : int
        Samples of the run before the first period; by default those of the way into the path.

    Raises
    ------
    ValueError
        If the recording does not contain the whole scan.
    """
    recording = played.recording()
    displacement_um = recording.displacement_um[recording.playing | recording.tracking]
    end = (before or len(scan.begin_voltage_v)) + periods * len(scan.voltage_v)
    if recording.gaps or len(displacement_um) < end:
        raise ValueError(f"{played.path} does not hold the whole scan: play it again")
    return Scanned(played.path, scan, displacement_um[end - len(scan.voltage_v):end])
