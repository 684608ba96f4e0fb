# SPDX-License-Identifier: BSD-3-Clause
"""A steering mirror on three piezo stacks: one model for its three levels of excitation.

All inputs are excited together (orthogonal random-phase multisines); no axis is measured alone. The
error is that of the benchmark: RMS error over the standard deviation, averaged over outputs,
realisations and periods.
"""

from pathlib import Path

import numpy as np

from piezo_identification.axes.identify_axes import identify_several_axes
from piezo_identification.axes.predict_axes import errors_percent
from piezo_models.axes.identified_axes import IdentifiedAxes
from piezo_recorder.reading.axes import AxesRecording, axes_recordings_of_arrays
from piezo_studies.measured_devices.measured import Figure

FOLDER = "fine_steering_mirror"
LEVELS_MV = (100, 200, 300)
SAMPLE_RATE_HZ = 6400.0
AXES = ("a", "b", "c")
UM_PER_M = 1e6

PUBLISHED_PERCENT = (6.37, 4.84, 4.19)
"""Errors of the best published model for all levels, a neural network in feedback with a linear
model."""

BOUNDS_PERCENT = (5.6, 4.5, 4.2)
"""Errors of the best linear approximation of each single level."""

PAIRS = 24
"""Pairs of poles, as for the table in the docs. The evidence alone selects 33 poles, with errors of
5.40, 3.87 and 4.09 % on the test set."""

FILES = tuple(f"{FOLDER}/{signal}_{level}mV_{part}.npy" for level in LEVELS_MV
              for part in ("train", "test") for signal in ("u", "y"))


def mirror(directory: Path) -> tuple[list[Figure], IdentifiedAxes]:
    """Identify one model from the training data of all levels, and predict their test data."""
    fitted = [each for level in LEVELS_MV for each in _recordings(directory, level, "train")]
    identified = identify_several_axes(fitted, pairs=PAIRS, note=print)
    figures = []
    for level, published, bound in zip(LEVELS_MV, PUBLISHED_PERCENT, BOUNDS_PERCENT, strict=True):
        errors = errors_percent(identified.model, _recordings(directory, level, "test"))
        figures.append(Figure(
            "steering mirror", "relative error", "all levels", f"{level} mV, test set", "%",
            published, bound, float(np.mean([each["e_y_percent"] for each in errors.values()]))))
    return figures, identified


def _recordings(directory: Path, level: int, part: str) -> list[AxesRecording]:
    voltage_v, displacement_m = (
        np.load(Path(directory) / FOLDER / f"{signal}_{level}mV_{part}.npy") for signal in "uy")
    return axes_recordings_of_arrays(
        voltage_v, UM_PER_M * displacement_m, SAMPLE_RATE_HZ, AXES,
        ("sample", "channel", "realisation", "period"), name=f"{level} mV {part}")
