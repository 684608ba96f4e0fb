# SPDX-License-Identifier: BSD-3-Clause
"""The linear response of a model, with the band that follows from its standard deviations."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_common.picture_style import (
    BAND,
    BLUE,
    MEASURED,
    MODELLED,
    label,
    new_figure,
    plain_numbers,
)
from piezo_models.cascade import StageModel
from piezo_models.model_pictures import drawn_frequencies

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from piezo_models.identified_model import IdentifiedModel

HEIGHT_IN = 5.0

STEP = 0.01
"""Step of the numerical derivative, as a fraction of the parameter's standard deviation."""


def bode_of(identified: "IdentifiedModel") -> "Figure":
    """Draw gain and phase of a model's linear part with their bands."""
    figure = new_figure(HEIGHT_IN)
    gain, phase = figure.subplots(2, 1, sharex=True)
    draw_bode(gain, phase, identified, drawn_frequencies(identified.model))
    return figure


def response_deviations(
    identified: "IdentifiedModel", frequency_hz: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the standard deviations of a model's linear response, (F,).

    They are those of the logarithm of the magnitude, and of the phase in rad. Each parameter of
    creep and dynamics is varied by itself. The errors are assumed independent, as the model file
    holds no covariances. Parameters that the recordings do not determine are excluded.
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


def draw_bode(gain: "Axes", phase: "Axes", identified: "IdentifiedModel",
              frequency_hz: FloatArray,
              measured: tuple[FloatArray, ComplexArray] | None = None) -> None:
    """Draw gain and phase of a model's linear part with their bands and a measured response.

    The latter is frequencies in Hz and complex response, as `measured_response` returns them.
    """
    response = identified.model.response(frequency_hz)
    magnitude, phase_rad = response_deviations(identified, frequency_hz)
    size, angle = np.abs(response), np.degrees(np.unwrap(np.angle(response)))
    band: dict[str, Any] = {"color": BLUE, "alpha": 0.25, "linewidth": 0.0, "label": "band of 95 %"}
    if measured is not None and measured[0].size:
        points = {**MEASURED, "linestyle": "none", "marker": "o", "markersize": 4}
        gain.loglog(measured[0], np.abs(measured[1]), **points)
        # Shift the measured phase by full turns to lie near that of the model.
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
