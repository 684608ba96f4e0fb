# SPDX-License-Identifier: BSD-3-Clause
"""Figure of measured and simulated displacement."""

from matplotlib.figure import Figure

from piezo_common.arrays import FloatArray
from piezo_common.picture_style import (
    BAND,
    BLUE,
    DIFFERENCE,
    MEASURED,
    MODELLED,
    WIDE_IN,
    label,
    new_figure,
)
from piezo_identification.prediction.prediction import Prediction


def displacement_figure(prediction: Prediction,
                        deviation_um: FloatArray | None = None) -> Figure:
    """Draw measured and simulated displacement over time, and their difference.

    Parameters
    ----------
    deviation_um : ndarray, shape (N,), optional
        Standard deviation of the simulated displacement, drawn as a band of twice its size.
    """
    figure = new_figure(5.0, WIDE_IN)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    above.plot(prediction.time_s, prediction.measured_um, **MEASURED)
    above.plot(prediction.time_s, prediction.simulated_um, **MODELLED)
    above.legend(loc="upper right")
    label(above, y="displacement (um)", title=f"e_y = {prediction.e_y_percent():.3g} %")
    error_nm = 1e3 * (prediction.measured_um - prediction.simulated_um)
    if deviation_um is not None and deviation_um.any():
        band_nm = 1e3 * BAND * deviation_um
        below.fill_between(prediction.time_s, -band_nm, band_nm, color=BLUE, alpha=0.2,
                           linewidth=0.0, label="outside the identification")
        below.legend(loc="upper right")
    below.plot(prediction.time_s, error_nm, **DIFFERENCE)
    label(below, "time (s)", "difference (nm)")
    return figure
