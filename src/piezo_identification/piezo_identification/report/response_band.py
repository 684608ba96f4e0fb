# SPDX-License-Identifier: BSD-3-Clause
"""The linear response of a model with its band, and the points that a recording shows of it."""

from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from piezo_common.arrays import ComplexArray, FloatArray, IntArray
from piezo_common.picture_style import BLUE, MEASURED, MODELLED, label, plain_numbers
from piezo_identification.adequacy.component_residual import ComponentResidual
from piezo_identification.adequacy.lack_of_fit import LackOfFit
from piezo_identification.analysis.gain_over_frequency import gain_of
from piezo_identification.report.signal_pictures import BAND
from piezo_models.cascade import StageModel
from piezo_models.identified_model import IdentifiedModel

POINTS = 500
STEP = 0.01
"""Part of a standard deviation by which a parameter is moved to see what depends on it."""

CLEARANCE = 10.0
"""A line that does not stand out of the noise by this factor tells nothing."""

COHERENT = 0.9
MOST_MEASURED = 300


def response_deviations(
    identified: IdentifiedModel, frequency_hz: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the standard deviations of a model's linear response.

    Each parameter of creep and dynamics is moved; their errors are taken for independent, as the
    model file keeps no covariances. What the recordings do not tell at all is left out.

    Parameters
    ----------
    frequency_hz : ndarray, shape (F,)

    Returns
    -------
    magnitude, phase_rad : ndarray, shape (F,)
        Of the logarithm of the magnitude, and of the phase.
    """
    model = identified.model
    nominal = model.response(frequency_hz)
    variance = np.zeros((2, frequency_hz.size))
    for part in "creep", "dynamics":
        for name, deviations in identified.uncertainties.get(part, {}).items():
            of_field = np.atleast_1d(np.asarray(deviations, float))
            for index in np.flatnonzero(np.isfinite(of_field) & (of_field > 0.0)):
                moved = _moved(model, part, name, int(index), STEP * of_field[index])
                change = np.log(moved.response(frequency_hz) / nominal) / STEP
                variance += np.stack([change.real**2, change.imag**2])
    magnitude, phase_rad = np.sqrt(variance)
    return magnitude, phase_rad


def _moved(model: StageModel, part: str, name: str, index: int, change: float) -> StageModel:
    component = getattr(model, part)
    value = getattr(component, name)
    if np.ndim(value) == 0:
        moved = value + change
    else:
        moved = tuple(one + (change if place == index else 0.0)
                      for place, one in enumerate(value))
    return replace(model, **{part: replace(component, **{name: moved})})


def measured_response(
    model: StageModel, residual: ComponentResidual, fit: LackOfFit,
) -> tuple[FloatArray, ComplexArray]:
    """Return the response that a recording shows of a model's linear part.

    That is the model's, times the response from what was fitted to what was measured: so it holds
    for any waveform, and the offset and the gain of the hysteresis are as they were fitted.

    Parameters
    ----------
    fit : LackOfFit
        Of that residual.

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
    """Return which of many frequencies to draw: about even over their logarithm."""
    if frequency_hz.size <= MOST_MEASURED:
        return np.arange(frequency_hz.size)
    cells = np.floor(np.log(frequency_hz / frequency_hz[0])
                     / np.log(frequency_hz[-1] / frequency_hz[0]) * MOST_MEASURED)
    return np.asarray(np.unique(cells, return_index=True)[1], dtype=np.int_)


def draw_bode(gain: Axes, phase: Axes, identified: IdentifiedModel, frequency_hz: FloatArray,
              measured: tuple[FloatArray, ComplexArray] | None = None) -> None:
    """Draw gain and phase of a model's linear part with their bands, and what was measured.

    Parameters
    ----------
    frequency_hz : ndarray, shape (F,)
    measured : tuple of ndarray, optional
        Of `measured_response`.
    """
    response = identified.model.response(frequency_hz)
    magnitude, phase_rad = response_deviations(identified, frequency_hz)
    size, angle = np.abs(response), np.degrees(np.unwrap(np.angle(response)))
    band: dict[str, Any] = {"color": BLUE, "alpha": 0.25, "linewidth": 0.0, "label": "band of 95 %"}
    if measured is not None and measured[0].size:
        points = {**MEASURED, "linestyle": "none", "marker": "o", "markersize": 4}
        gain.loglog(measured[0], np.abs(measured[1]), **points)
        # On the model's branch of the angle, wherever the first point lies.
        near = np.interp(measured[0], frequency_hz, angle)
        off = np.degrees(np.angle(measured[1] * np.exp(-1j * np.radians(near))))
        phase.semilogx(measured[0], near + off, **points)
    gain.fill_between(frequency_hz, size * np.exp(-BAND * magnitude),
                      size * np.exp(BAND * magnitude), **band)
    gain.loglog(frequency_hz, size, **MODELLED)
    width = BAND * np.degrees(phase_rad)
    phase.fill_between(frequency_hz, angle - width, angle + width, **band)
    phase.semilogx(frequency_hz, angle, **MODELLED)
    gain.legend(loc="lower left")
    label(gain, y="gain (um/um)")
    label(phase, "frequency (Hz)", "phase (degrees)")
    plain_numbers(gain.yaxis)
    plain_numbers(phase.xaxis)


def shown_frequencies(identified: IdentifiedModel, sample_period_s: float | None,
                      measured_hz: FloatArray | None = None) -> FloatArray:
    """Return the frequencies of a Bode diagram: from the slowest creep to above the fastest mode.

    Parameters
    ----------
    sample_period_s : float or None
        Of the fast recording: no higher than half its rate.
    measured_hz : ndarray, optional
        Are to be among them.
    """
    model = identified.model
    lag_s = model.dynamics.time_constant_s
    rates = [*model.creep.poles_rad_per_s, *model.dynamics.mode_frequencies_rad_per_s,
             *model.dynamics.antiresonance_frequencies_rad_per_s, *([1.0 / lag_s] if lag_s else [])]
    corners = [rate / (2.0 * np.pi) for rate in rates] or [1.0]
    low, high = 0.3 * min(corners), 3.0 * max(corners)
    if measured_hz is not None and measured_hz.size:
        low, high = min(low, measured_hz.min()), max(high, min(measured_hz.max(), 10.0 * high))
    if sample_period_s is not None:
        high = max(min(high, 0.5 / sample_period_s), 2.0 * low)
    return np.geomspace(low, high, POINTS)
