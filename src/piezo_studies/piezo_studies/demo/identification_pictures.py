# SPDX-License-Identifier: BSD-3-Clause
"""Figures that compare the identified model with measurements."""

import numpy as np

from piezo_common.picture_style import (
    BLACK,
    DIFFERENCE,
    MEASURED,
    MODELLED,
    label,
    new_figure,
    plain_numbers,
)
from piezo_models.linear.dynamics import zoh_response

NANOMETRES = 1e3
CREEP_START_S = 0.03
DRAWN_POINTS = 3000
# A voltage that crosses its whole range quicker than this shows dynamics instead of hysteresis.
SLOW_CROSSING_S = 0.05
RESPONSE_HZ = (10.0, 2500.0)


def draw_loops(prediction):
    """Draw the hysteresis loops, measured and modelled, and their difference.

    Parameters
    ----------
    prediction : piezo_identification.prediction.Prediction
        Prediction for the validation recording; its initial slow part is drawn.
    """
    end = _end_of_slow_part(prediction)
    slow = slice(0, end, max(1, end // DRAWN_POINTS))
    voltage_v, measured_um = prediction.voltage_v[slow], prediction.measured_um[slow]
    simulated_um = prediction.simulated_um[slow]
    figure = new_figure(5.0)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    above.plot(voltage_v, measured_um, **MEASURED)
    above.plot(voltage_v, simulated_um, **MODELLED)
    above.legend(loc="upper left")
    label(above, y="displacement (um)")
    below.plot(voltage_v, NANOMETRES * (measured_um - simulated_um), **DIFFERENCE)
    label(below, "voltage (V)", "difference (nm)")
    return figure


def draw_creep(prediction):
    """Draw the creep after a step, measured and modelled, over the logarithm of time.

    Parameters
    ----------
    prediction : piezo_identification.prediction.Prediction
        Prediction for the creep recording.
    """
    step = int(np.argmax(np.abs(np.diff(prediction.voltage_v)))) + 1
    since_s = prediction.time_s[step:] - prediction.time_s[step]
    shown = since_s >= CREEP_START_S
    since_s = since_s[shown]
    measured_um = prediction.measured_um[step:][shown]
    simulated_um = prediction.simulated_um[step:][shown]
    start_um = simulated_um[0]
    figure = new_figure(4.6)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    above.semilogx(since_s, measured_um - start_um, **MEASURED)
    above.semilogx(since_s, simulated_um - start_um, **MODELLED)
    above.legend()
    label(above, y="creep (um)")
    below.semilogx(since_s, NANOMETRES * (measured_um - simulated_um), **DIFFERENCE)
    label(below, "time since the step (s)", "difference (nm)")
    plain_numbers(below.xaxis)
    return figure


def draw_frequency_response(dynamics, sample_period_s, measured):
    """Draw gain and phase of the linear dynamics, and those measured with a square wave.

    Parameters
    ----------
    dynamics : control.StateSpace
        Continuous system from the output of the hysteresis to the displacement.
    sample_period_s : float
        Sample period with which the model is discretized.
    measured : tuple of ndarray
        Frequency (Hz) and complex response.
    """
    frequency_hz = np.geomspace(*RESPONSE_HZ, 600)
    response = zoh_response(dynamics, frequency_hz, sample_period_s)
    points = {**MEASURED, "linestyle": "none", "marker": "o", "markersize": 5}
    figure = new_figure(4.8)
    above, below = figure.subplots(2, 1, sharex=True)
    above.loglog(measured[0], np.abs(measured[1]), **points)
    above.loglog(frequency_hz, np.abs(response), **MODELLED)
    above.legend(loc="lower left")
    label(above, y="gain (um/um)")
    plain_numbers(above.yaxis)
    below.semilogx(measured[0], np.degrees(np.unwrap(np.angle(measured[1]))), **points)
    below.semilogx(frequency_hz, np.degrees(np.unwrap(np.angle(response))), **MODELLED)
    label(below, "frequency (Hz)", "phase (degrees)")
    below.set_yticks(np.arange(-450, 1, 90))
    plain_numbers(below.xaxis)
    return figure


def draw_step_response(prediction, period_s):
    """Draw the response to one period of the short square wave, measured and modelled.

    Parameters
    ----------
    prediction : piezo_identification.prediction.Prediction
        Prediction for the dynamics recording.
    period_s : float
        Period of the square wave.
    """
    steps = np.flatnonzero(np.diff(prediction.voltage_v)) + 1
    middle = steps[steps.size // 2]
    shown = ((prediction.time_s >= prediction.time_s[middle])
             & (prediction.time_s < prediction.time_s[middle] + period_s))
    time_ms = 1e3 * (prediction.time_s[shown] - prediction.time_s[middle])
    figure = new_figure(4.6)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    above.plot(time_ms, prediction.measured_um[shown], **MEASURED)
    above.plot(time_ms, prediction.simulated_um[shown], **MODELLED)
    above.legend()
    label(above, y="displacement (um)")
    difference_um = prediction.measured_um[shown] - prediction.simulated_um[shown]
    below.plot(time_ms, NANOMETRES * difference_um, **DIFFERENCE)
    label(below, "time since a step (ms)", "difference (nm)")
    return figure


def draw_density(hysteresis):
    """Draw the density of the relays over their thresholds.

    Parameters
    ----------
    hysteresis : PreisachModel
    """
    levels_v = hysteresis.levels_v
    density = np.ma.array(hysteresis.density_um_per_v2,
                          mask=np.triu(np.ones_like(hysteresis.density_um_per_v2), 1))
    figure = new_figure(4.6)
    axes = figure.subplots()
    image = axes.pcolormesh(levels_v, levels_v, NANOMETRES * density, cmap="cividis")
    figure.colorbar(image, ax=axes, label="density (nm/V²)")
    axes.plot(levels_v[[0, -1]], levels_v[[0, -1]], color=BLACK, linewidth=0.8)
    axes.set_aspect("equal")
    label(axes, "voltage at which a relay switches off (V)",
          "voltage at which it switches on (V)")
    axes.grid(False)
    return figure


def _end_of_slow_part(prediction):
    rate_v_per_s = np.abs(np.diff(prediction.voltage_v)) / np.diff(prediction.time_s)
    quick = rate_v_per_s > np.ptp(prediction.voltage_v) / SLOW_CROSSING_S
    return int(np.argmax(quick)) if quick.any() else prediction.voltage_v.size
