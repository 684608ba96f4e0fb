# SPDX-License-Identifier: BSD-3-Clause
"""Paths and points from CSV files."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_common.schema import load_document
from piezo_controller.axes.path_marks import lead_samples
from piezo_controller.references.kind import InvalidReference
from piezo_recorder.images.scan_frame import SCAN_FILE, ScanFrame
from piezo_recorder.reading.axes import axes_with_voltage
from piezo_recorder.reading.detected import marks_in
from piezo_recorder.sample_block import Mark

SUFFIX = "_displacement_um"

LARGEST_STEP = 3.0
"""Largest distance from the last position to the first, in steps of the path, that is no jump."""


def points_of_file(path: str | Path) -> tuple[tuple[str, ...], FloatArray]:
    """Return the axes and points (K, m) of a CSV with columns such as ``x_displacement_um``.

    Raises `InvalidReference` if there are none, or a row is not of numbers.
    """
    return _points_in(_columns(Path(path)), path)


def _points_in(columns: dict[str, FloatArray],
               path: str | Path) -> tuple[tuple[str, ...], FloatArray]:
    axes = tuple(name.removesuffix(SUFFIX) for name in columns if name.endswith(SUFFIX))
    if len(axes) < 2:
        raise InvalidReference(f"{path} has the columns {', '.join(columns)}: give two or three "
                               f"such as x{SUFFIX}")
    return axes, np.column_stack([columns[axis + SUFFIX] for axis in axes])


def positions_of_file(
    path: str | Path, sample_period_s: float,
) -> tuple[tuple[str, ...], FloatArray, NDArray[np.int64]]:
    """Read one period of a path, sampled at the sample rate, with its marks; see `points_of_file`.

    The marks are those of columns such as ``pixel`` and ``line``. A plan of `scan` has them earlier
    than their places by the delay of its sensors, which its description beside it contains.

    Raises `InvalidReference` if its times are not those of the samples, or its end jumps to its
    beginning.
    """
    columns = _columns(Path(path))
    axes, position_um = _points_in(columns, path)
    time_s = columns.get("time_s")
    samples = np.arange(len(position_um))
    if time_s is None or np.abs(time_s - time_s[0] - samples * sample_period_s).max() > (
            0.01 * sample_period_s):
        raise InvalidReference(f"{path} has no column time_s at {1.0 / sample_period_s:.6g} Hz, "
                               "the rate of the model: resample it to that rate")
    steps = np.linalg.norm(np.diff(position_um, axis=0, append=position_um[:1]), axis=1)
    if steps[-1] > LARGEST_STEP * max(steps[-2], steps[0]):
        raise InvalidReference(f"{path} jumps by {steps[-1]:.4g} um from its last position to its "
                               "first: let it end where it begins")
    marks = np.resize(marks_in(columns), len(position_um)).astype(int)
    described = Path(path).parent / SCAN_FILE
    if axes_with_voltage(list(columns)) and described.exists():
        frame = load_document(ScanFrame, described)
        own = [axes.index(axis) for axis in frame.axes]
        marks = np.roll(marks, lead_samples(
            position_um[:, own], marks, np.array(frame.sensor_delay_s) / sample_period_s))
    marks[0] |= 0 if np.any(marks & Mark.FRAME) else Mark.FRAME
    return axes, position_um, marks


def _columns(path: Path) -> dict[str, FloatArray]:
    try:
        with open(path, encoding="utf-8") as file:
            names = [name.strip() for name in file.readline().split(",")]
            values = np.loadtxt(file, delimiter=",", ndmin=2)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "a row is not of numbers"
        raise InvalidReference(f"{path} cannot be read: {reason}; give a CSV with a header such as "
                               f"time_s,x{SUFFIX},y{SUFFIX}") from None
    if values.shape[1] != len(names) or not np.isfinite(values).all():
        raise InvalidReference(f"{path} has a row that has not a finite number in each of "
                               f"{', '.join(names)}: mend it")
    return dict(zip(names, values.T, strict=True))
