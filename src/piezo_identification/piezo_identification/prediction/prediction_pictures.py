# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of measured and simulated displacement."""

from pathlib import Path

from piezo_common.picture_style import (
    DIFFERENCE,
    MEASURED,
    MODELLED,
    WIDE_IN,
    label,
    new_figure,
)
from piezo_identification.prediction.prediction import Prediction

DOTS_PER_INCH = 120


def draw_displacement(path: str | Path, prediction: Prediction) -> None:
    """Draw measured and simulated displacement over time, and their difference.

    Parameters
    ----------
    path : path-like
        Picture to write.
    prediction : Prediction
    """
    figure = new_figure(5.0, WIDE_IN)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    above.plot(prediction.time_s, prediction.measured_um, **MEASURED)
    above.plot(prediction.time_s, prediction.simulated_um, **MODELLED)
    above.legend(loc="upper right")
    label(above, y="displacement (um)", title=f"e_y = {prediction.e_y_percent():.3g} %")
    error_nm = 1e3 * (prediction.measured_um - prediction.simulated_um)
    below.plot(prediction.time_s, error_nm, **DIFFERENCE)
    label(below, "time (s)", "difference (nm)")
    figure.savefig(path, dpi=DOTS_PER_INCH)


def draw_loops(path: str | Path, prediction: Prediction) -> None:
    """Draw measured and simulated displacement over voltage.

    Parameters
    ----------
    path : path-like
        Picture to write.
    prediction : Prediction
    """
    figure = new_figure(5.0, WIDE_IN)
    axes = figure.subplots()
    axes.plot(prediction.voltage_v, prediction.measured_um, **MEASURED)
    axes.plot(prediction.voltage_v, prediction.simulated_um, **MODELLED)
    axes.legend(loc="upper left")
    label(axes, "voltage (V)", "displacement (um)")
    figure.savefig(path, dpi=DOTS_PER_INCH)
