# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of measured data of other stages beside our models."""

import numpy as np

from piezo_identification.prediction_pictures import new_figure


def draw_loops_and_difference(path, title, prediction):
    """Draw displacement over voltage, and the difference sample by sample.

    Parameters
    ----------
    path : path-like
        Picture to write.
    title : str
    prediction : Prediction
    """
    figure = new_figure(8.0, 4.0)
    left, right = figure.subplots(1, 2)
    left.plot(prediction.voltage_v, prediction.measured_um, label="measured")
    left.plot(prediction.voltage_v, prediction.simulated_um, "--", linewidth=0.8, label="simulated")
    left.set(xlabel="voltage / V", ylabel="displacement / um")
    left.legend(loc="upper left")
    difference_um = prediction.measured_um - prediction.simulated_um
    right.plot(prediction.time_s, difference_um, color="tab:red", linewidth=0.5)
    right.set(xlabel="time / s", ylabel="measured - simulated / um")
    figure.suptitle(title)
    figure.savefig(path)


def draw_ringing(path, title, ringing, fitted_s):
    """Draw the response to a jump, and the difference.

    Parameters
    ----------
    path : path-like
        Picture to write.
    title : str
    ringing : Ringing
    fitted_s : float
        Time after the jump up to which the dynamics were fitted.
    """
    response = ringing.response
    time_ms = 1e3 * response.time_s
    figure = new_figure(8.0, 5.0)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    above.plot(time_ms, response.displacement_um, ".", markersize=4, label="measured")
    above.plot(time_ms, ringing.modelled_um, linewidth=0.9, label="modelled")
    above.set_ylabel("displacement / um")
    above.legend(loc="upper right")
    above.set_title(title)
    below.plot(time_ms, response.displacement_um - ringing.modelled_um, color="tab:red",
               linewidth=0.7)
    below.set(xlabel="time after the jump / ms", ylabel="difference / um")
    for axes in above, below:
        axes.axvline(1e3 * fitted_s, color="0.6", linewidth=0.8)
    above.text(1e3 * fitted_s, above.get_ylim()[0], " not fitted from here on", va="bottom",
               color="0.4", size="small")
    figure.savefig(path)


def draw_frequency_response(path, title, frequency_hz, measured, modelled, predicted):
    """Draw gain and phase of a measured response and of its model.

    Parameters
    ----------
    path : path-like
        Picture to write.
    title : str
    frequency_hz : ndarray, shape (N,)
    measured : ndarray of complex, shape (N,)
    modelled, predicted : ndarray of complex, shape (N,)
        By the model fitted to all frequencies, and each by one that was not fitted to it.
    """
    figure = new_figure(8.0, 5.5)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    above.loglog(frequency_hz, np.abs(measured), ".", markersize=4, label="measured")
    above.loglog(frequency_hz, np.abs(modelled), linewidth=0.9, label="modelled")
    above.loglog(frequency_hz, np.abs(measured - modelled), color="tab:red", linewidth=0.7,
                 label="difference")
    above.loglog(frequency_hz, np.abs(measured - predicted), ".", color="tab:red", markersize=2,
                 label="difference where not fitted")
    above.set_ylabel("gain")
    above.legend(loc="center left", ncols=2, fontsize="small")
    above.set_title(title)
    for response, style in ((measured, "."), (modelled, "-")):
        below.semilogx(frequency_hz, np.degrees(np.unwrap(np.angle(response))), style,
                       markersize=4, linewidth=0.9)
    below.set(xlabel="frequency / Hz", ylabel="phase / degrees")
    figure.savefig(path)
