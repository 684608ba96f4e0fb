# SPDX-License-Identifier: BSD-3-Clause
"""The measured response of a model's linear part, and the frequencies at which it is drawn."""

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray, IntArray
from piezo_identification.adequacy.component_residual import ComponentResidual
from piezo_identification.adequacy.lack_of_fit import LackOfFit
from piezo_identification.analysis.gain_over_frequency import gain_of
from piezo_models.cascade import StageModel
from piezo_models.model_pictures import drawn_frequencies

POINTS = 500

CLEARANCE = 10.0
"""Smallest ratio of a line to the noise for which the line is used."""

COHERENT = 0.9
MOST_MEASURED = 300


def measured_response(
    model: StageModel, residual: ComponentResidual, fit: LackOfFit,
) -> tuple[FloatArray, ComplexArray]:
    """Return the measured response of the linear part of a model.

    It is the response of the model times the response from fitted to measured displacement. It is
    thus valid for any waveform; offset and gain of the hysteresis are those of the fit.

    Returns
    -------
    frequency_hz : ndarray, shape (M,)
    response : ndarray of complex, shape (M,)
    """
    fitted_um = residual.measured_um - residual.residual_um
    frequency_hz: FloatArray
    ratio: ComplexArray
    if residual.frequency_hz is not None:
        half = residual.frequency_hz.size // 2
        frequency_hz = residual.frequency_hz[:half]
        ratio = np.asarray(
            (residual.measured_um[:half] + 1j * residual.measured_um[half:])
            / (fitted_um[:half] + 1j * fitted_um[half:]), dtype=complex)
    elif residual.period and residual.measured_um.size >= 2 * residual.period:
        period = residual.period
        repeats = fitted_um.size // period
        fitted, measured = (np.fft.rfft(values[: repeats * period].reshape(repeats, period).mean(0))
                            for values in (fitted_um, residual.measured_um))
        clear = np.abs(fitted) > CLEARANCE * fit.noise_rms_um * np.sqrt(period)
        clear[0] = False
        frequency_hz = np.fft.rfftfreq(period, residual.sample_period_s)[clear]
        ratio = measured[clear] / fitted[clear]
    else:
        frequency_hz, ratio, coherence = gain_of(
            fitted_um, residual.measured_um, residual.sample_period_s)
        frequency_hz, ratio = frequency_hz[coherence > COHERENT], ratio[coherence > COHERENT]
    kept = _thinned(frequency_hz)
    return frequency_hz[kept], ratio[kept] * model.response(frequency_hz[kept])


def _thinned(frequency_hz: FloatArray) -> IntArray:
    """Return the indices of the frequencies to draw, about evenly spaced in their logarithm."""
    if frequency_hz.size <= MOST_MEASURED:
        return np.arange(frequency_hz.size)
    cells = np.floor(np.log(frequency_hz / frequency_hz[0])
                     / np.log(frequency_hz[-1] / frequency_hz[0]) * MOST_MEASURED)
    return np.asarray(np.unique(cells, return_index=True)[1], dtype=np.int_)


def shown_frequencies(model: StageModel, sample_period_s: float | None,
                      measured_hz: FloatArray | None) -> FloatArray:
    """Return the frequencies of a Bode diagram of a model and a measurement.

    Parameters
    ----------
    sample_period_s : float or None
        Sample period of the fast recording; half its sample rate is the highest frequency.
    measured_hz : ndarray or None
        Measured frequencies that the range must include.
    """
    low, high = drawn_frequencies(model)[[0, -1]]
    if measured_hz is not None and measured_hz.size:
        low, high = min(low, measured_hz.min()), max(high, min(measured_hz.max(), 10.0 * high))
    if sample_period_s is not None:
        high = max(min(high, 0.5 / sample_period_s), 2.0 * low)
    return np.geomspace(low, high, POINTS)
