# SPDX-License-Identifier: BSD-3-Clause
"""Images: the signal of a detector over the positions at which it was measured."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CloughTocher2DInterpolator, LinearNDInterpolator
from scipy.spatial import Delaunay, QhullError, cKDTree

from piezo_common.arrays import FloatArray
from piezo_common.gsf import Field
from piezo_recorder.images.scan_frame import ScanFrame, frame_in
from piezo_recorder.reading.axes import AxesRecording
from piezo_recorder.reading.recording import RecordingError
from piezo_recorder.sample_block import Mark

NEAR_PIXELS = 0.25
"""Distance up to which a pixel outside all measured positions takes the value of the nearest."""

FAR_PIXELS = 1.5
"""Distance from all measured positions beyond which nothing is interpolated: lines at a distance of
twice that were left out, as where the path turned outside of the image."""


@dataclass(frozen=True, eq=False)
class ScanImage:
    """A signal on a grid of pixels; pixels that were not reached are NaN."""

    signal: str
    """Name of the detector; the unit, if it has one, is its last part, as in ``height_um``."""
    frame: ScanFrame

    values: FloatArray
    """Shape (rows, columns); the first row has the lowest coordinate of the second axis."""
    deviation: FloatArray
    """Standard deviation of the values: that of the mean of the samples of a pixel, which contains
    the noise and the change within the pixel. NaN where a pixel has one sample."""
    moved_um: FloatArray
    """Measured position of what each pixel shows minus its place in the image, (rows, columns,
    2)."""
    visited_um: FloatArray
    """Mean position of the samples of each marked pixel in the order of time, (K, 2)."""
    visited_values: FloatArray
    """Their mean signal, (K,)."""

    def __repr__(self) -> str:
        columns, rows = self.frame.pixels
        return f"<ScanImage: {self.signal} of a {self.frame.path}, {columns} x {rows} pixels>"

    @property
    def unit(self) -> str:
        """Return the unit of the signal; empty if its name has none."""
        return "um" if self.signal.endswith("_um") else ""

    def field(self, values: FloatArray) -> Field:
        """Return the values or the deviation of the image as a field with its place and unit."""
        return Field(values, self.frame.corner_um, self.frame.size_um, self.unit, self.signal)


def image_of(recording: AxesRecording, signal: str = "", frame: ScanFrame | None = None,
             position_um: FloatArray | None = None) -> ScanImage:
    """Return the image of the last frame in the recording of a scan.

    Samples around each mark of a pixel are averaged. Between the mean positions the signal is
    interpolated by cubic triangles (Clough and Tocher). Readings that are late are taken from later
    samples.

    Parameters
    ----------
    signal : str
        Detector; the first one by default.
    frame : ScanFrame, optional
        By default the one that is stored in the recording.
    position_um : (N, axes) array, optional
        Readings in place of the measured ones: the commanded path gives the image that a stage
        without sensors would show.

    Raises
    ------
    RecordingError
        If the recording lacks a signal, marks or a whole frame.

    Examples
    --------
    Ten pixels of four samples in each of 30 lines:

    >>> import numpy as np
    >>> from piezo_recorder import ScanFrame, axes_recordings_in
    >>> row, column = np.divmod(np.arange(1200), 40)
    >>> x_um, y_um = 0.1 * column, 0.1 * row
    >>> recording, = axes_recordings_in({
    ...     "time_s": 1e-3 * np.arange(1200), "x_voltage_v": x_um, "y_voltage_v": y_um,
    ...     "x_displacement_um": x_um, "y_displacement_um": y_um,
    ...     "pixel": np.where(column % 4 == 2, 1.0, 0.0), "camera_signal": np.sin(x_um)})
    >>> frame = ScanFrame(
    ...     format="piezo_scan", version=1, path="raster", axes=["x", "y"], pixels=[10, 30],
    ...     pixel_um=[0.4, 0.1], centre_um=[2.0, 1.45], marked_pixels=300, sensor_delay_s=[0, 0])
    >>> image_of(recording, frame=frame)
    <ScanImage: camera of a raster, 10 x 30 pixels>
    """
    frame = frame or frame_in(recording.attachments, recording.path)
    signals = recording.signals
    name = signal or next(iter(signals), "")
    if name not in signals:
        raise RecordingError(f"{recording.path} has the signals {', '.join(signals) or '(none)'}: "
                             f"{'choose one' if signals else 'record a stage with a detector'}")
    marked = np.flatnonzero(recording.marks & Mark.PIXEL)[-frame.marked_pixels:]
    if len(marked) < frame.marked_pixels:
        raise RecordingError(f"{recording.path} has {len(marked)} samples that are marked as "
                             f"pixels, a frame has {frame.marked_pixels}: record a whole frame")
    dwell = _Dwell(marked, len(recording.voltage_v))
    measured_um = _at_pixels(recording.displacement_um, recording, frame, dwell)
    visited_um = measured_um if position_um is None else _at_pixels(
        position_um, recording, frame, dwell)
    values, spread = dwell.mean_and_deviation(signals[name])
    gridded = _gridded(visited_um, np.column_stack([values, spread, measured_um]), frame)
    return ScanImage(name, frame, gridded[..., 0], gridded[..., 1],
                     gridded[..., 2:] - frame.places_um(), visited_um, values)


class _Dwell:
    """The samples of each pixel: half the distance of two pixels on either side of its mark."""

    def __init__(self, marked: np.ndarray, samples: int):
        half = int(np.median(np.diff(marked))) // 2
        self._begin = np.maximum(marked - half, 0)
        self._end = np.minimum(marked + half + 1, samples)
        self.count = self._end - self._begin

    def mean(self, values: FloatArray) -> FloatArray:
        """Return the mean of the samples of each pixel, (K,)."""
        centre = np.nanmean(values)
        summed = np.concatenate([[0.0], np.cumsum(values - centre)])
        mean: FloatArray = centre + (summed[self._end] - summed[self._begin]) / self.count
        return mean

    def mean_and_deviation(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the mean of the samples of each pixel, and its standard deviation, (K,)."""
        mean, centre = self.mean(values), np.mean(values)
        square = self.mean((values - centre) ** 2) - (mean - centre) ** 2
        several = np.where(self.count > 1, self.count - 1.0, np.nan)
        return mean, np.sqrt(np.maximum(square, 0.0) / several)


def _at_pixels(reading_um: FloatArray, recording: AxesRecording, frame: ScanFrame,
               dwell: _Dwell) -> FloatArray:
    """Return the mean positions of the samples of each pixel along both axes, (K, 2)."""
    sample = np.arange(len(reading_um), dtype=float)
    columns = []
    for axis, delay_s in zip(frame.axes, frame.sensor_delay_s, strict=True):
        own = reading_um[:, recording.axes.index(axis)]
        columns.append(dwell.mean(np.interp(
            sample + delay_s / recording.sample_period_s, sample, own)))
    return np.column_stack(columns)


def _gridded(visited_um: FloatArray, values: FloatArray, frame: ScanFrame) -> FloatArray:
    """Interpolate values, (K, n), at the places of the pixels, (rows, columns, n).

    The first, the signal, is interpolated by cubic triangles, the others by plane ones.
    """
    on_a_line = RecordingError(f"the pixels of the {frame.path} lie on a line: an image needs two "
                               "directions")
    if min(frame.pixel_um) == 0.0:
        raise on_a_line
    visited, places = visited_um / frame.pixel_um, frame.places_um() / frame.pixel_um
    try:
        triangles = Delaunay(visited)
    except QhullError:
        raise on_a_line from None
    found: FloatArray = LinearNDInterpolator(triangles, values)(places)
    # Half a line away from the lines, a straight line would cut off what is curved.
    found[..., 0] = CloughTocher2DInterpolator(triangles, values[:, 0])(places)
    distance, nearest = cKDTree(visited).query(places)
    at_the_rim = np.isnan(found[..., -1]) & (distance <= NEAR_PIXELS)
    found[at_the_rim] = values[nearest[at_the_rim]]
    found[distance > FAR_PIXELS] = np.nan
    return found
