# SPDX-License-Identifier: BSD-3-Clause
"""A path planned by `scan`: play it on the stage, and evaluate how well the axes followed it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from piezo_client.paths import AnyPath
from piezo_client.results import Played
from piezo_common.arrays import FloatArray
from piezo_common.summary_table import SummaryTable
from piezo_recorder.reading.axes import read_axes
from piezo_recorder.reading.waveform_file import read_waveform

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

    def repeated_v(self, periods: int) -> FloatArray:
        """Return the voltages of the way into the path and of some periods of it, (T, n)."""
        return np.concatenate([self.begin_voltage_v, *[self.voltage_v] * periods])


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
    return StoredScan(period.axes, begin.sample_period_s, begin.voltage_v, period.voltage_v,
                      period.displacement_um)


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
        np.savetxt(folder / name, np.column_stack(list(columns.values())), "%.9g", ",",
                   header=",".join(columns), comments="")


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
