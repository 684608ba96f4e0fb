# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of a feedback loop: Bode and Nyquist diagrams, weights, structured singular value."""

from pathlib import Path

import control
import numpy as np

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
from piezo_controller.feedback.loop_measures import loop_responses
from piezo_controller.feedback.synthesis.weights import DesignWeights, Weight

LOWEST_HZ = 0.1
LOWEST_WEIGHT = 1e-4
DOTS_PER_INCH = 120


def draw_bode(path: str | Path, plant: control.StateSpace, controller: control.StateSpace,
              weights: DesignWeights | None) -> None:
    """Open loop above, closed loop with the bounds that the weights set below.

    Parameters
    ----------
    path : path-like
        PNG to write.
    plant, controller : control.StateSpace
        Discrete; the plant with its gain in um/V.
    weights : DesignWeights or None
        None for a design without weights.
    """
    frequency_hz = _frequencies(plant.dt)
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
    figure.savefig(path, dpi=DOTS_PER_INCH)


def draw_nyquist(path: str | Path, plant: control.StateSpace, controller: control.StateSpace,
                 gain_spread: float) -> None:
    """Draw the open loop in the complex plane, nominal and at both ends of the gain's spread.

    Parameters
    ----------
    path : path-like
        PNG to write.
    plant, controller : control.StateSpace
        Discrete; the plant with its gain in um/V.
    gain_spread : float
        The plant's gain may lie within ``1 +- gain_spread`` of its nominal value.
    """
    loop, sensitivity = loop_responses(plant, controller, _frequencies(plant.dt))
    peak = np.abs(sensitivity).max()
    turn = np.exp(1j * np.linspace(0, 2 * np.pi, 400))

    figure = new_figure(7.0, 7.0)
    axes = figure.subplots()
    axes.plot(turn.real, turn.imag, color=GREY, label="unit circle")
    circle = -1 + turn / peak
    axes.plot(circle.real, circle.imag, label=f"peak sensitivity {peak:.2f}", **LIMIT)
    for gain, color, linestyle in ((1 - gain_spread, ORANGE, "--"), (1, BLUE, "-"),
                                   (1 + gain_spread, VERMILION, "-.")):
        axes.plot(gain * loop.real, gain * loop.imag, color=color, linestyle=linestyle,
                  label=f"open loop, gain {gain:.2f}")
    axes.plot(-1, 0, color=BLACK, linestyle="none", marker="+", markersize=12)
    axes.set(xlim=(-3, 1.5), ylim=(-2.25, 2.25), aspect="equal")
    label(axes, "real part (1)", "imaginary part (1)")
    axes.legend(loc="lower right")
    figure.savefig(path, dpi=DOTS_PER_INCH)


def draw_weights(path: str | Path, weights: DesignWeights) -> None:
    """Draw the weights over frequency.

    Parameters
    ----------
    path : path-like
        PNG to write.
    weights : DesignWeights
    """
    tick_s = weights.sample_period_s
    frequency_hz = _frequencies(tick_s)
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
    figure.savefig(path, dpi=DOTS_PER_INCH)


def draw_mu(path: str | Path, frequency_hz: FloatArray, mu: FloatArray,
            history: list[float]) -> None:
    """Draw the structured singular value over frequency, and its peak from iterate to iterate.

    Parameters
    ----------
    path : path-like
        PNG to write.
    frequency_hz, mu : ndarray, shape (F,)
        Of the final controller; zero frequency is left out.
    history : list of float
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
    figure.savefig(path, dpi=DOTS_PER_INCH)


def _size(weight: Weight, frequency_hz: FloatArray, tick_s: float) -> FloatArray:
    points = np.exp(2j * np.pi * frequency_hz * tick_s)
    return np.abs(weight.state_space(tick_s)(points, squeeze=True)) * np.ones_like(frequency_hz)


def _frequencies(tick_s: float) -> FloatArray:
    return np.geomspace(LOWEST_HZ, 0.5 / tick_s, 2000)
