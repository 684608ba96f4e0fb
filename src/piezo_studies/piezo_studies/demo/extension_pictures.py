# SPDX-License-Identifier: BSD-3-Clause
"""Figures of a model and of tracking before and after the extension of the model."""

import numpy as np
from scipy.signal import welch

from piezo_common.picture_style import AFTER, BEFORE, LIMIT, label, new_figure, plain_numbers
from piezo_models.linear.dynamics import zoh_response

RESPONSE_HZ = np.geomspace(50.0, 4000.0, 1500)
SEGMENT = 8192
SHOWN_PERIODS = 2
QUIET_HZ = 8000.0
"""Frequency above which the stage does not move, so that the signal is sensor noise."""


def _compared(before, after):
    """Draw two curves, each of frequencies and values, on new double-logarithmic axes."""
    figure = new_figure()
    axes = figure.subplots()
    for curve, style in ((before, BEFORE), (after, AFTER)):
        axes.loglog(*curve, **style)
    return figure, axes


def draw_model_errors(before, after, sample_period_s):
    """Draw the spectra of a model's error on one recording, before and after.

    Parameters
    ----------
    before, after : piezo_identification.prediction.Prediction
    """
    def density(prediction):
        frequency_hz, power = welch(
            1e3 * (prediction.measured_um - prediction.simulated_um), 1.0 / sample_period_s,
            nperseg=min(SEGMENT, prediction.measured_um.size))
        return frequency_hz[1:-1], np.sqrt(power[1:-1])

    curves = density(before), density(after)
    figure, axes = _compared(*curves)
    frequency_hz, residual = curves[1]
    axes.axhline(np.median(residual[frequency_hz > QUIET_HZ]), label="noise", **LIMIT)
    axes.legend()
    label(axes, "frequency (Hz)", "model error (nm per root Hz)")
    return figure


def draw_responses(before, after, sample_period_s):
    """Draw the magnitude of the sampled linear part of two models.

    Parameters
    ----------
    before, after : piezo_models.cascade.StageModel
    """
    figure, axes = _compared(*(
        (RESPONSE_HZ, np.abs(zoh_response(model.linear(), RESPONSE_HZ, sample_period_s)))
        for model in (before, after)))
    axes.legend()
    plain_numbers(axes.xaxis)
    label(axes, "frequency (Hz)", "magnitude (um/um)")
    return figure


def draw_tracking_errors(before, after):
    """Draw the errors of runs over their last periods, a row for each frequency.

    Parameters
    ----------
    before, after : dict of float to TrackedRun
        Runs by frequency in Hz.
    """
    figure = new_figure(1.2 + 1.5 * len(after))
    rows = figure.subplots(len(after), 1, squeeze=False)[:, 0]
    for axes, frequency_hz in zip(rows, sorted(after), strict=True):
        for runs, style in ((before, BEFORE), (after, AFTER)):
            run = runs[frequency_hz]
            count = round(SHOWN_PERIODS * run.sample_rate_hz / frequency_hz)
            time_ms = 1e3 * np.arange(count) / run.sample_rate_hz
            axes.plot(time_ms, 1e3 * run.error_um[-count:], **style)
        label(axes, "time (ms)", "error (nm)",
              title=f"{frequency_hz:g} Hz, {run.amplitude_um:g} um peak to peak")
    figure.legend(*rows[0].get_legend_handles_labels(), loc="outside upper center", ncols=2,
                  frameon=False)
    figure.align_ylabels()
    return figure
