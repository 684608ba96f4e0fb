# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of a model: its Preisach plane, its loops and its frequency response."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_common.picture_style import (
    BLACK,
    BLUE,
    CURVES,
    WIDE_IN,
    label,
    new_figure,
)
from piezo_models.hysteresis.preisach import PreisachModel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from piezo_models.cascade import StageModel

AMPLITUDES = (1.0, 0.75, 0.5, 0.25)
"""Fractions of the voltage range that the drawn loops cover."""

POINTS = 400
MARGIN = 3.0
"""Factor by which the drawn frequencies exceed the slowest and fastest rates of the model."""

STATIC_HZ = (1.0, 1000.0)
"""Frequency range in Hz drawn for a model that has neither creep nor dynamics."""


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
