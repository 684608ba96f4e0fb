# SPDX-License-Identifier: BSD-3-Clause
"""Three public data sets not used to tune constants: two tanks, a flexible arm, a CD player's arm.

None is a piezo stage. They test `identify` on recordings for which it was not designed: few rows,
no rest before them, and dynamics that no model here represents.
"""

from pathlib import Path

import numpy as np

from piezo_identification import identify
from piezo_identification.axes.identify_axes import identify_several_axes
from piezo_identification.prediction import predict
from piezo_identification.prediction.row_reading import read_as_identified
from piezo_recorder import recording_of
from piezo_recorder.reading.axes import axes_recordings_in
from piezo_recorder.reading.recording import Recording
from piezo_studies.measured_devices.measured import Figure
from piezo_studies.measured_devices.oscillators import FITTED_PART, divided, rms_um

TANKS, ROBOT_ARM = "cascaded_tanks/dataBenchmark.csv", "robot_arm/robot_arm.dat"
PLAYER_ARM = "cd_player_arm/CD_player_arm.dat"

TANKS_PERIOD_S, UNKNOWN_PERIOD_S = 4.0, 1e-3
"""Sample period of the tanks, and an arbitrary one for the arms, whose sample periods are not
published; it only scales their frequencies."""


def tanks(directory: Path) -> list[Figure]:
    """Identify two tanks in series, and predict the level for another pump voltage."""
    rows = np.genfromtxt(Path(directory) / TANKS, delimiter=",", skip_header=1)[:, :4]
    fitted, unseen = (_recording(rows[:, i], rows[:, 2 + i], TANKS_PERIOD_S) for i in range(2))
    return [Figure("cascaded tanks", "RMS", "estimation", "validation", "V", 0.757, 0.757,
                   rms_um(identify(dynamics=fitted).model, unseen),
                   "published: linear; nonlinear 0.34")]


def robot_arm(directory: Path) -> list[Figure]:
    """Identify a flexible arm from the beginning of its record, and predict the rest."""
    rows = np.loadtxt(Path(directory) / ROBOT_ARM)
    # The output falls as the input rises.
    whole = _recording(rows[:, 0], -rows[:, 1], UNKNOWN_PERIOD_S)
    fitted, unseen = divided(whole)
    identified = identify(dynamics=fitted)
    error = predict(identified.model, read_as_identified(identified, unseen)[0]).e_y_percent()
    return [Figure("robot arm", "relative error", "first part", "the rest", "%", np.nan, 15.0,
                   error)]


def player_arm(directory: Path) -> list[Figure]:
    """Identify the arm of a CD player, two axes in closed loop, and predict the rest."""
    rows = np.loadtxt(Path(directory) / PLAYER_ARM)
    last = int(FITTED_PART * len(rows))
    fitted, unseen = (axes_recordings_in({
        "time_s": UNKNOWN_PERIOD_S * np.arange(len(part)),
        "x_voltage_v": part[:, 0], "y_voltage_v": part[:, 1],
        "x_displacement_um": part[:, 2], "y_displacement_um": part[:, 3],
    }) for part in (rows[:last], rows[last:]))
    errors = identify_several_axes(fitted, unseen).errors
    return [Figure("CD player's arm", f"relative error, {axis}", "first part", "the rest", "%",
                   np.nan, 35.0, error["e_y_percent"]) for axis, error in errors.items()]


def _recording(voltage_v: np.ndarray, displacement_um: np.ndarray, period_s: float) -> Recording:
    return recording_of({"time_s": period_s * np.arange(voltage_v.size), "voltage_v": voltage_v,
                         "displacement_um": displacement_um})
