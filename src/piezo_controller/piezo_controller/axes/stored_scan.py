# SPDX-License-Identifier: BSD-3-Clause
"""The voltages of a planned path, and the folder that holds them."""

from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_common.schema import load_document
from piezo_recorder.images.scan_frame import SCAN_FILE, ScanFrame
from piezo_recorder.reading.axes import read_axes
from piezo_recorder.reading.detected import mark_columns
from piezo_recorder.reading.waveform_file import read_waveform

if TYPE_CHECKING:
    from piezo_controller.axes.path_plan import PathPlan

SAME_PERIOD = 1e-9
"""Relative difference of sample periods up to which they are one: rounding."""

PERIOD_FILE, BEGIN_FILE = "path.csv", "begin.csv"
"""Files of `scan`: one period to repeat, and the way from the operating point into it."""


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

    @property
    def travel_um(self) -> FloatArray:
        """Return the peak-to-peak position of each axis; the largest for an axis that rests, (n,).

        Errors are relative to it.
        """
        own_um = np.ptp(self.position_um, axis=0)
        travel_um: FloatArray = np.where(own_um > 0.0, own_um, own_um.max())
        return travel_um

    def columns(self) -> dict[str, FloatArray]:
        """Return the period as the columns of a table of several axes, with its marks."""
        samples = len(self.voltage_v)
        return {
            "time_s": self.sample_period_s * np.arange(samples, dtype=float),
            **_of_axes(self.axes, "voltage_v", self.voltage_v),
            **_of_axes(self.axes, "displacement_um", self.position_um),
            **(mark_columns(self.marks) if self.marks.size else {})}

    @property
    def attachments(self) -> dict[str, str]:
        """Return what a recording holds for the images, by the names of files."""
        return {} if self.frame is None else {SCAN_FILE: self.frame.model_dump_json()}

    def checked_frame(self) -> ScanFrame:
        """Return the pixels of the image; raise ValueError if no pixels are marked."""
        if self.frame is None:
            raise ValueError("the scan has no pixels whose places could be measured: plan a "
                             "pattern with pixels")
        return self.frame

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


def read_scan(directory: str | PathLike[str]) -> StoredScan:
    """Read the voltages that `scan` wrote into a folder.

    Raises ValueError if a file is missing, or the two files do not belong together.
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


def write_scan(scan: StoredScan, directory: str | PathLike[str]) -> None:
    """Write voltages, positions and marks into a folder, for `read_scan`."""
    folder = Path(directory)
    folder.mkdir(parents=True, exist_ok=True)
    begin_v = scan.begin_voltage_v
    for name, columns in (
            (PERIOD_FILE, scan.columns()),
            (BEGIN_FILE, {"time_s": scan.sample_period_s * np.arange(len(begin_v)),
                          **_of_axes(scan.axes, "voltage_v", begin_v)})):
        np.savetxt(folder / name, np.column_stack(list(columns.values())), "%.9g", ",",
                   header=",".join(columns), comments="")
    if scan.frame is not None:
        (folder / SCAN_FILE).write_text(
            scan.frame.model_dump_json(indent=1) + "\n", encoding="utf-8")


def _of_axes(axes: tuple[str, ...], signal: str, values: FloatArray) -> dict[str, FloatArray]:
    return {f"{axis}_{signal}": column for axis, column in zip(axes, values.T, strict=True)}
