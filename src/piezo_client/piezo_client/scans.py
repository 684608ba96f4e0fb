# SPDX-License-Identifier: BSD-3-Clause
"""How well the axes followed a path that was played, and the images of it."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from piezo_client.results import Played
from piezo_common.arrays import FloatArray
from piezo_common.summary_table import SummaryTable
from piezo_controller.axes.stored_scan import StoredScan
from piezo_recorder.reading.axes import read_axes

if TYPE_CHECKING:
    from piezo_recorder.images.scan_image import ScanImage

MAX_FEEDBACK_V = 20.0
"""Largest voltage of a feedback by default, as that of the controller node."""


def images_of(run: "Scanned", name: str, signal: str = "") -> "dict[str, ScanImage]":
    """Return the images of a run, by the commanded positions and by the measured ones.

    Their names begin with what the run is. Raises ValueError if the recording has no signal, or the
    scan no pixels.
    """
    # Imported here, since SciPy takes as long as all that drives a stage.
    from piezo_recorder.images.scan_image import image_of

    recording, = read_axes(run.path)
    position_um = run.scan.position_um
    at = np.maximum(np.arange(len(recording.voltage_v)) - run.before_samples, 0)
    commanded_um = position_um[at % len(position_um)]
    return {f"{name}, as commanded": image_of(recording, signal, position_um=commanded_um),
            f"{name}, as measured": image_of(recording, signal)}


@dataclass(frozen=True)
class Scanned(Played):
    """A path that was played."""

    scan: StoredScan
    displacement_um: FloatArray
    """Displacement measured in the last period, (N, n)."""
    before_samples: int = 0
    """Samples of the run before the first period."""

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
        percent: FloatArray = 100.0 * np.std(self.error_um, axis=0) / self.scan.travel_um
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

    The samples before the first period are by default those of the way into the path. Raises
    ValueError if the recording does not contain the whole scan.
    """
    recording = played.recording()
    displacement_um = recording.displacement_um[recording.playing | recording.tracking]
    before = before or len(scan.begin_voltage_v)
    end = before + periods * len(scan.voltage_v)
    if recording.gaps or len(displacement_um) < end:
        raise ValueError(f"{played.path} does not hold the whole scan: play it again")
    return Scanned(played.path, scan, displacement_um[end - len(scan.voltage_v):end], before)
