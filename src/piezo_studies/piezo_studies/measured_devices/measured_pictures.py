# SPDX-License-Identifier: BSD-3-Clause
"""Figures of measured data of other stages and of our models."""

import numpy as np

from piezo_common.picture_style import (
    DIFFERENCE,
    GREEN,
    MEASURED,
    MODELLED,
    VERMILION,
    WIDE_IN,
    label,
    new_figure,
)

DOTS_PER_INCH = 120
POINTS = MEASURED | {"linestyle": "none", "marker": "o", "markersize": 4}


def draw_loops_and_difference(path, title, prediction):
    """Draw displacement over voltage, and the difference sample by sample."""
    figure = new_figure(4.0, WIDE_IN)
    left, right = figure.subplots(1, 2)
    left.plot(prediction.voltage_v, prediction.measured_um, **MEASURED)
    left.plot(prediction.voltage_v, prediction.simulated_um, **MODELLED)
    left.legend(loc="upper left")
    label(left, "voltage (V)", "displacement (um)")
    difference_um = prediction.measured_um - prediction.simulated_um
    right.plot(prediction.time_s, difference_um, **DIFFERENCE)
    label(right, "time (s)", "measured - modelled (um)")
    figure.suptitle(title)
    figure.savefig(path, dpi=DOTS_PER_INCH)


def draw_frequency_response(path, title, frequency_hz, measured, modelled, predicted):
    """Draw gain and phase of a measured response, of its model, and as predicted, (N,) each.

    Each predicted value is that of the model whose fit omitted this frequency.
    """
    figure = new_figure(5.5, WIDE_IN)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    above.loglog(frequency_hz, np.abs(measured), **POINTS)
    above.loglog(frequency_hz, np.abs(modelled), **MODELLED)
    above.loglog(frequency_hz, np.abs(measured - modelled), color=GREEN, linestyle="--",
                 linewidth=0.9, label="difference")
    above.loglog(frequency_hz, np.abs(measured - predicted), color=VERMILION, linestyle="none",
                 marker="x", markersize=3, label="difference where not fitted")
    above.legend(loc="center left", ncols=2, fontsize="small")
    label(above, y="gain (unit of the data)", title=title)
    for response, style in ((measured, POINTS), (modelled, MODELLED)):
        below.semilogx(frequency_hz, np.degrees(np.unwrap(np.angle(response))), **style)
    label(below, "frequency (Hz)", "phase (degrees)")
    figure.savefig(path, dpi=DOTS_PER_INCH)
