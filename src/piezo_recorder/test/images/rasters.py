# SPDX-License-Identifier: BSD-3-Clause
"""Recordings of rasters over a specimen that is known everywhere, with sensors that are late."""

import numpy as np
from scipy.ndimage import map_coordinates

from piezo_common.gsf import Field
from piezo_recorder.images.scan_frame import FORMAT, SCAN_FILE, VERSION, ScanFrame
from piezo_recorder.reading.axes import AxesRecording
from piezo_recorder.reading.detected import mark_columns
from piezo_recorder.sample_block import Mark

PERIOD_S, LATE = 1e-4, (0.3, 1.6)
COLUMNS, ROWS, DWELL = 48, 40, 10
CENTRE_UM, PIXEL_UM = (5.0, -2.0), (0.1, 0.12)
SPAN_UM = 12.0


def specimen():
    """Heights with structures of about 1 um everywhere."""
    random = np.random.default_rng(3)
    at_um = (np.arange(240) + 0.5) * SPAN_UM / 240
    heights = np.zeros((240, 240))
    for angle, phase in zip(random.uniform(0.0, np.pi, 40), random.uniform(0.0, 6.3, 40),
                            strict=True):
        along = np.add.outer(at_um * np.sin(angle), at_um * np.cos(angle))
        heights += 0.01 * np.cos(2.0 * np.pi * along / random.uniform(0.8, 1.6) + phase)
    corner = tuple(each - 0.5 * SPAN_UM for each in CENTRE_UM)
    return Field(heights, corner, (SPAN_UM, SPAN_UM), "um")


def frame(**changes):
    return ScanFrame(**{
        "format": FORMAT, "version": VERSION, "path": "raster of a test", "axes": ["x", "y"],
        "pixels": [COLUMNS, ROWS], "pixel_um": list(PIXEL_UM), "centre_um": list(CENTRE_UM),
        "marked_pixels": COLUMNS * ROWS, "sensor_delay_s": [each * PERIOD_S for each in LATE],
        **changes})


def raster(way=1):
    """Positions and marks of one frame with lines that go forward, and back where way is -1."""
    line, turn = COLUMNS * DWELL, 200
    back = 0.5 * np.cos(np.pi * np.arange(turn) / turn) if way > 0 else np.full(turn, 0.5)
    fast = np.r_[np.linspace(-0.5, 0.5, line, endpoint=False), back]
    marks = np.zeros((ROWS, line + turn), int)
    marks[:, DWELL // 2:line:DWELL] = Mark.PIXEL
    marks[:, 0] |= Mark.LINE
    x = np.tile(fast, (ROWS, 1))
    if way < 0:
        x[1::2] *= -1.0
    y = np.repeat(np.arange(ROWS) - 0.5 * (ROWS - 1), line + turn)
    return np.column_stack([CENTRE_UM[0] + COLUMNS * PIXEL_UM[0] * x.ravel(),
                            CENTRE_UM[1] + PIXEL_UM[1] * y]), marks.ravel()


def recorded(commanded_um, marks, true_um=None, noise_um=0.0):
    """A recording of two detectors while the sensors tell of true positions late."""
    true_um = commanded_um if true_um is None else true_um
    field, sample = specimen(), np.arange(len(true_um))
    height_um = map_coordinates(field.values, field.pixels_at(true_um), mode="nearest")
    read_um = np.column_stack([np.interp(sample - late, sample, column)
                               for late, column in zip(LATE, true_um.T, strict=True)])
    random = np.random.default_rng(8)
    return AxesRecording(
        "run", ("x", "y"), PERIOD_S, np.zeros_like(read_um), read_um,
        columns={"height_um_signal": height_um + noise_um * random.normal(size=height_um.size),
                 "camera_signal": -height_um, **mark_columns(marks)},
        attachments={SCAN_FILE: frame().model_dump_json().encode()})
