# SPDX-License-Identifier: BSD-3-Clause
"""Figures of a feedback loop: Bode and Nyquist diagrams, weights, structured singular value."""

from collections.abc import Sequence
from typing import Any

import control
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_common.picture_style import (
    BLACK,
    BLUE,
    CURVES,
    GREY,
    LIMIT,
    ORANGE,
    VERMILION,
    WIDE_IN,
    label,
    new_figure,
)
from piezo_controller.feedback.loop_measures import (
    SETTLED,
    Margins,
    loop_margins,
    loop_responses,
    sensitivity_of_axes,
)
from piezo_controller.feedback.synthesis.weights import DesignWeights, Weight

LOWEST_HZ = 0.1
LOWEST_WEIGHT = 1e-4
STEPS_TICKS, LEAST_TICKS, SHOWN_SETTLINGS = 400, 30, 4
MARKED: dict[str, Any] = {"color": VERMILION, "linewidth": 2.0}
GAIN_STYLES: tuple[dict[str, Any], ...] = (
    {"color": ORANGE, "linestyle": "--"}, {"color": BLUE, "linestyle": "-"},
    {"color": VERMILION, "linestyle": "-."})
"""Styles of the loop at the lowest, the nominal and the highest hysteresis gain."""


def bode_figure(plant: control.StateSpace, controller: control.StateSpace,
                weights: DesignWeights | None) -> Figure:
    """Draw the open loop with its margins, and below it the closed one with the weights' bounds.

    The plant has its gain in um/V. A design without weights has none.
    """
    frequency_hz = drawn_frequencies(plant.dt)
    points = np.exp(2j * np.pi * frequency_hz * plant.dt)
    loop, sensitivity = loop_responses(plant, controller, frequency_hz)

    figure = new_figure(9.0, WIDE_IN)
    gain, phase, closed = figure.subplots(3, sharex=True)
    for response, name, style in zip(
            (loop, plant(points, squeeze=True), controller(points, squeeze=True)),
            ("open loop G k$_h$ K (1)", "plant G k$_h$ (um/V)", "controller K (V/um)"),
            CURVES, strict=False):
        gain.loglog(frequency_hz, np.abs(response), label=name, **style)
    phase.semilogx(frequency_hz, np.degrees(np.unwrap(np.angle(loop))), label="open loop",
                   **CURVES[0])
    _mark_margins(gain, phase, frequency_hz, loop, loop_margins(plant, controller))
    bounded: dict[str, FloatArray | ComplexArray] = {
        "sensitivity S": sensitivity, "complementary T": 1 - sensitivity}
    if weights is not None:
        w1, w2, w_d = (_size(weight, frequency_hz, plant.dt) for weight in (
            weights.performance, weights.control, weights.disturbance))
        bounded["1 / |w$_1$ w$_d$|"] = 1 / (w1 * w_d)
        bounded["|G k$_h$| / |w$_2$ w$_d$|"] = plant(points, squeeze=True) / w2 / w_d
    for (name, response), style in zip(bounded.items(), CURVES, strict=False):
        closed.loglog(frequency_hz, np.abs(response), label=name, **style)
    gain.set_ylim(1e-3, None)
    closed.set_ylim(1e-3, 1e2)
    label(gain, y="gain (units in the legend)")
    label(phase, y="phase (degrees)")
    label(closed, "frequency (Hz)", "gain (um/um)")
    for axes in gain, phase, closed:
        axes.legend()
    return figure


def _mark_margins(gain: Axes, phase: Axes, frequency_hz: FloatArray, loop: ComplexArray,
                  margins: Margins) -> None:
    """Mark the gain margin and the phase margin at their frequencies."""
    gain.axhline(1.0, **LIMIT)
    if margins.gain is not None and margins.gain_hz is not None:
        gain.plot([margins.gain_hz] * 3, [1.0 / margins.gain, margins.gain**-0.5, 1.0],
                  marker="_", label=f"gain margin {margins.gain:.3g}", **MARKED)
    angle = np.degrees(np.unwrap(np.angle(loop)))
    if margins.phase_deg is not None and margins.phase_hz is not None:
        at = float(np.interp(margins.phase_hz, frequency_hz, angle))
        # The nearest of the angles at which the loop would be -1.
        unstable = 180.0 * (2.0 * np.floor(at / 360.0) + 1.0)
        phase.axhline(unstable, **LIMIT)
        phase.plot([margins.phase_hz] * 3, [unstable, 0.5 * (unstable + at), at], marker="_",
                   label=f"phase margin {margins.phase_deg:.0f} degrees", **MARKED)


def nyquist_figure(plant: control.StateSpace, controller: control.StateSpace,
                   gain_spread: float) -> Figure:
    """Draw the open loop in the complex plane, nominal and at both ends of the gain's spread.

    The plant has its gain in um/V, which may lie within ``1 +- gain_spread`` of its nominal value.
    """
    figure = new_figure(7.0, 7.0)
    axes = figure.subplots()
    nyquist_on(axes, plant, controller, gain_spread)
    _mark_in_plane(axes, loop_margins(plant, controller))
    axes.legend(loc="lower right")
    return figure


def nyquist_on(axes: Axes, plant: control.StateSpace, controller: control.StateSpace,
               gain_spread: float) -> None:
    """Draw the open loop of `nyquist_figure` with the circle of the peak sensitivity."""
    loop, sensitivity = loop_responses(plant, controller, drawn_frequencies(plant.dt))
    peak = np.abs(sensitivity).max()
    turn = np.exp(1j * np.linspace(0, 2 * np.pi, 400))
    axes.plot(turn.real, turn.imag, color=GREY, label="unit circle")
    circle = -1 + turn / peak
    axes.plot(circle.real, circle.imag, label=f"peak sensitivity {peak:.2f}", **LIMIT)
    for gain, style in zip((1 - gain_spread, 1, 1 + gain_spread), GAIN_STYLES, strict=True):
        axes.plot(gain * loop.real, gain * loop.imag, label=f"open loop, gain {gain:.2f}", **style)
    axes.plot(-1, 0, color=BLACK, linestyle="none", marker="+", markersize=12)
    axes.set(xlim=(-3, 1.5), ylim=(-2.25, 2.25), aspect="equal")
    label(axes, "real part (1)", "imaginary part (1)")


def _mark_in_plane(axes: Axes, margins: Margins) -> None:
    """Draw the margins of the nominal loop: on the real axis, and along the unit circle."""
    if margins.gain is not None:
        axes.plot([-1.0, -0.5 - 0.5 / margins.gain, -1.0 / margins.gain], [0.0, 0.0, 0.0],
                  marker="|", label=f"gain margin {margins.gain:.3g}", **MARKED)
    if margins.phase_deg is not None:
        arc = np.exp(1j * (np.pi + np.radians(np.linspace(0.0, margins.phase_deg, 30))))
        axes.plot(arc.real, arc.imag, linestyle=(0, (2, 1)),
                  label=f"phase margin {margins.phase_deg:.0f} degrees", **MARKED)


def step_figure(plant: control.StateSpace, controller: control.StateSpace, gain_spread: float,
                drawn: Sequence[control.StateSpace] = ()) -> Figure:
    """Draw the responses of displacement to a reference step, and of error to a disturbance.

    Plant and spread are those of `nyquist_figure`; the responses of drawn plants make the band.
    """
    time_s = np.arange(_shown_ticks(plant, controller)) * plant.dt
    figure = new_figure(5.6, WIDE_IN)
    above, below = figure.subplots(2, 1, sharex=True)
    for axes, of_error, name in ((above, False, "displacement (um)"), (below, True, "error (um)")):
        def response(of: control.StateSpace, of_error: bool = of_error) -> FloatArray:
            loop = of * controller
            closed = control.feedback(1, loop) if of_error else control.feedback(loop, 1)
            return np.asarray(control.step_response(closed, time_s).outputs)

        if drawn:
            responses = np.array([response(each) for each in drawn])
            axes.fill_between(1e3 * time_s, responses.min(axis=0), responses.max(axis=0),
                              color=GREY, alpha=0.5, linewidth=0.0,
                              label=f"{len(drawn)} models with errors")
        for gain, style in zip((1 - gain_spread, 1, 1 + gain_spread), GAIN_STYLES, strict=True):
            axes.plot(1e3 * time_s, response(gain * plant), label=f"gain {gain:.2f}", **style)
        axes.axhline(0.0 if of_error else 1.0, **LIMIT)
        label(axes, y=name, title="after a disturbance of 1 um" if of_error
              else "after a step of the reference by 1 um, by the feedback alone")
    above.legend(loc="lower right")
    below.set_xlabel("time (ms)")
    return figure


def _shown_ticks(plant: control.StateSpace, controller: control.StateSpace) -> int:
    """Return the number of ticks to draw: several settling times of the error."""
    time_s = np.arange(STEPS_TICKS) * plant.dt
    error = control.step_response(control.feedback(1, plant * controller), time_s).outputs
    outside = np.flatnonzero(np.abs(error) > SETTLED)
    return int(np.clip(SHOWN_SETTLINGS * (outside[-1] + 1 if outside.size else 0), LEAST_TICKS,
                       STEPS_TICKS))


def sensitivity_figure(plant: control.StateSpace, controller: control.StateSpace,
                       drawn: Sequence[control.StateSpace] = (),
                       axes: Sequence[str] = ()) -> Figure:
    """Draw the sensitivity of the loop, and the band of its size for perturbed models.

    The plant has its gain in um/V. Axes are named if there are several.
    """
    frequency_hz = drawn_frequencies(plant.dt)[::4]
    figure = new_figure(4.4)
    shown = figure.subplots()
    if drawn:
        sizes = np.linalg.norm([sensitivity_of_axes(each, controller, frequency_hz)
                                for each in drawn], 2, axis=(2, 3))
        shown.fill_between(frequency_hz, sizes.min(axis=0), sizes.max(axis=0), color=GREY,
                           alpha=0.5, linewidth=0.0, label=f"S of {len(drawn)} models with errors")
    sensitivity = sensitivity_of_axes(plant, controller, frequency_hz)
    size = np.linalg.norm(sensitivity, 2, axis=(1, 2))
    curves = {"largest singular value of S": size} | {
        f"{axis} from its own disturbance": sensitivity[:, at, at]
        for at, axis in enumerate(axes)} if axes else {
        "sensitivity S": size, "complementary T": 1 - sensitivity[:, 0, 0]}
    for (name, values), style in zip(curves.items(), CURVES, strict=False):
        shown.loglog(frequency_hz, np.abs(values), label=name, **style)
    shown.axhline(1.0, **LIMIT)
    shown.set_ylim(1e-3, None)
    label(shown, "frequency (Hz)", "gain (um/um)")
    shown.legend(loc="lower right" if axes else "lower center")
    return figure


def weights_figure(weights: DesignWeights) -> Figure:
    """Draw the weights over frequency."""
    tick_s = weights.sample_period_s
    frequency_hz = drawn_frequencies(tick_s)
    figure = new_figure(5.0, WIDE_IN)
    axes = figure.subplots()
    for (name, text), style in zip((("performance", "w$_1$, error (1/um)"),
                                    ("control", "w$_2$, feedback voltage (1/V)"),
                                    ("disturbance", "w$_d$, disturbance (um)"),
                                    ("noise", "w$_n$, noise (um)"),
                                    ("reference", "w$_r$, reference (um)")), CURVES, strict=False):
        axes.loglog(frequency_hz, _size(getattr(weights, name), frequency_hz, tick_s), label=text,
                    **style)
    for value, text, style in (
            (weights.feedforward_error, "w$_\\delta$, error of the feedforward (1)", LIMIT),
            (weights.hysteresis_uncertainty, "w$_u$, gain of the hysteresis (1)",
             LIMIT | {"color": GREY, "linestyle": "-"})):
        axes.axhline(value, label=text, **style)
    axes.set_ylim(LOWEST_WEIGHT, None)
    label(axes, "frequency (Hz)", "weight (units in the legend)")
    axes.legend(ncols=2)
    return figure


def mu_figure(frequency_hz: FloatArray, mu: FloatArray, history: list[float]) -> Figure:
    """Draw the structured singular value over frequency, and its peak in each iteration.

    The value is that of the final controller, (F,).
    """
    figure = new_figure(4.0, WIDE_IN)
    over_frequency, over_iterates = figure.subplots(1, 2, sharey=True, width_ratios=(2, 1))
    over_frequency.semilogx(frequency_hz[frequency_hz > 0], mu[frequency_hz > 0], color=BLUE)
    over_frequency.axhline(mu.max(), label=f"peak {mu.max():.3f}", **LIMIT)
    over_frequency.set_ylim(0, 1.05 * max(*history, mu.max()))
    over_frequency.legend()
    label(over_frequency, "frequency (Hz)", "structured singular value (1)")
    over_iterates.plot(np.arange(1, len(history) + 1), history, color=BLUE, marker="o")
    label(over_iterates, "number of the synthesis")
    return figure


def _size(weight: Weight, frequency_hz: FloatArray, tick_s: float) -> FloatArray:
    points = np.exp(2j * np.pi * frequency_hz * tick_s)
    return np.abs(weight.state_space(tick_s)(points, squeeze=True)) * np.ones_like(frequency_hz)


def drawn_frequencies(tick_s: float) -> FloatArray:
    """Return the frequencies at which a loop is drawn, up to half the rate (Hz)."""
    return np.geomspace(LOWEST_HZ, 0.5 / tick_s, 2000)
