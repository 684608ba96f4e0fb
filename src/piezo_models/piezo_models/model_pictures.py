# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of a model: its Preisach plane, its loops, its frequency response and its band."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_common.picture_style import (
    BAND,
    BLACK,
    BLUE,
    CURVES,
    MEASURED,
    MODELLED,
    WIDE_IN,
    label,
    new_figure,
    plain_numbers,
)
from piezo_models.hysteresis.preisach import PreisachModel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from piezo_models.cascade import StageModel
    from piezo_models.identified_model import IdentifiedModel

AMPLITUDES = (1.0, 0.75, 0.5, 0.25)
"""Fractions of the voltage range that the drawn loops cover."""

POINTS = 400
MARGIN = 3.0
"""Factor by which the drawn frequencies exceed the slowest and fastest rates of the model."""

STATIC_HZ = (1.0, 1000.0)
"""Frequency range in Hz drawn for a model that has neither creep nor dynamics."""

STEP = 0.01
"""Step of the numerical derivative, as a fraction of the parameter's standard deviation."""

WIDEST_BAND = 10.0
"""Largest logarithm of the band of a gain that is drawn: an undetermined one has no end."""


def draw_model(model: "StageModel", visited: NDArray[np.bool_] | None = None) -> "Figure":
    """Draw Preisach plane, loops, and gain and phase of the linear part.

    Cells that recordings do not determine, by the mask `visited`, (L, L), are hatched.
    """
    figure = new_figure(6.4, WIDE_IN)
    (plane, gain), (loops, phase) = figure.subplots(2, 2)
    density_on(plane, model.hysteresis, visited)
    loops_on(loops, model.hysteresis)
    gain.sharex(phase)
    response_on(gain, phase, model)
    return figure


def density_on(axes: "Axes", hysteresis: PreisachModel,
               visited: NDArray[np.bool_] | None = None) -> None:
    """Draw the density of the relays over their thresholds; hatch unvisited cells, (L, L)."""
    levels_v, density = hysteresis.levels_v, hysteresis.density_um_per_v2
    below = np.tril(np.ones(density.shape, dtype=bool))
    drawn = axes.pcolormesh(levels_v, levels_v, np.ma.array(1e3 * density, mask=~below),
                            cmap="cividis")
    if visited is not None and not visited[below].all():
        centres_v = 0.5 * (levels_v[1:] + levels_v[:-1])
        hatched = axes.contourf(centres_v, centres_v, (below & ~visited).astype(float),
                                levels=[0.5, 1.5], colors="none", hatches=["///"])
        hatched.set_edgecolor("white")
        hatched.set_linewidth(0.0)
    axes.plot(levels_v[[0, -1]], levels_v[[0, -1]], color=BLACK, linewidth=0.8)
    axes.figure.colorbar(drawn, ax=axes, label="density (nm/V²)")
    label(axes, "relay switches off at (V)", "relay switches on at (V)",
          "Preisach plane" if visited is None else "Preisach plane, hatched: not visited")
    axes.grid(False)


def loops_on(axes: "Axes", hysteresis: PreisachModel) -> None:
    """Draw loops that rise from the lowest voltage to several fractions of the range."""
    low_v, high_v = hysteresis.voltage_min_v, hysteresis.voltage_max_v
    rise = np.linspace(0.0, 1.0, POINTS)
    way = np.concatenate([rise, rise[::-1], rise])
    for part, style in zip(AMPLITUDES, CURVES, strict=False):
        voltage_v = low_v + part * (high_v - low_v) * way
        settled = slice(POINTS, None)  # after the first rise, which is not part of a loop
        axes.plot(voltage_v[settled], hysteresis.simulate(voltage_v)[settled], **style)
    label(axes, "voltage (V)", "displacement (um)", "hysteresis")


def response_on(gain: "Axes", phase: "Axes", model: "StageModel") -> None:
    """Draw gain and phase of creep and dynamics, on one axis each."""
    frequency_hz = drawn_frequencies(model)
    response = model.response(frequency_hz)
    gain.loglog(frequency_hz, np.abs(response), color=BLUE, linewidth=1.2)
    phase.semilogx(frequency_hz, np.degrees(np.unwrap(np.angle(response))), color=BLUE,
                   linewidth=1.2)
    label(gain, None, "gain (um/um)", "creep and dynamics")
    label(phase, "frequency (Hz)", "phase (degrees)")


def drawn_frequencies(model: "StageModel") -> FloatArray:
    """Return frequencies in Hz from below the slowest pole to above the fastest mode."""
    dynamics = model.dynamics
    of_modes = [effect.frequency_rad_per_s for effect in model.effects_at("modes")]
    modes = [*dynamics.mode_frequencies_rad_per_s,
             *dynamics.antiresonance_frequencies_rad_per_s, *of_modes]
    # Recordings cannot show a lag far above the modes, so it does not extend the range.
    lag = [] if modes or not dynamics.time_constant_s else [1.0 / dynamics.time_constant_s]
    rates = [*model.creep.poles_rad_per_s, *model.creep.zeros_rad_per_s, *modes, *lag]
    low_hz, high_hz = STATIC_HZ
    if rates:
        low_hz, high_hz = (np.array([min(rates) / MARGIN, max(rates) * MARGIN]) / (2.0 * np.pi))
    return np.geomspace(low_hz, high_hz, POINTS)


def bode_of(identified: "IdentifiedModel") -> "Figure":
    """Draw gain and phase of a model's linear part with their bands."""
    figure = new_figure(5.0)
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


def _moved(model: "StageModel", part: str, name: str, index: int,
           change: float) -> "StageModel":
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
    factor = np.exp(np.minimum(BAND * magnitude, WIDEST_BAND))
    gain.fill_between(frequency_hz, size / factor, size * factor, **band)
    gain.loglog(frequency_hz, size, **MODELLED)
    width = BAND * np.degrees(phase_rad)
    phase.fill_between(frequency_hz, angle - width, angle + width, **band)
    phase.semilogx(frequency_hz, angle, **MODELLED)
    gain.legend(loc="lower left")
    label(gain, y="gain (um/um)")
    label(phase, "frequency (Hz)", "phase (degrees)")
    plain_numbers(gain.yaxis)
    plain_numbers(phase.xaxis)
