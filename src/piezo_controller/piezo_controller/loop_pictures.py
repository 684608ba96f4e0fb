# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of a feedback loop: Bode and Nyquist diagrams, weights, structured singular value."""

import numpy as np
from matplotlib.figure import Figure

from piezo_controller.loop_measures import loop_responses

LOWEST_HZ = 0.1
LOWEST_WEIGHT = 1e-4


def draw_bode(path, plant, controller, weights):
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

    figure = Figure(figsize=(8, 9), layout="constrained")
    gain, phase, closed = figure.subplots(3, sharex=True)
    gain.loglog(frequency_hz, np.abs(loop), label="open loop G k$_h$ K")
    gain.loglog(frequency_hz, np.abs(plant(points, squeeze=True)), label="plant G k$_h$ (um/V)")
    gain.loglog(frequency_hz, np.abs(controller(points, squeeze=True)), label="controller K (V/um)")
    phase.semilogx(frequency_hz, np.degrees(np.unwrap(np.angle(loop))), label="open loop")
    phase.set_ylabel("phase (deg)")
    closed.loglog(frequency_hz, np.abs(sensitivity), label="sensitivity S")
    closed.loglog(frequency_hz, np.abs(1 - sensitivity), label="complementary T")
    if weights is not None:
        w1, w2, w_d = (_size(weight, frequency_hz, plant.dt) for weight in (
            weights.performance, weights.control, weights.disturbance))
        closed.loglog(frequency_hz, 1 / (w1 * w_d), "--", label="1 / |w$_1$ w$_d$|")
        closed.loglog(frequency_hz, np.abs(plant(points, squeeze=True)) / w2 / w_d, "--",
                      label="|G k$_h$| / |w$_2$ w$_d$|")
    for axes in gain, closed:
        axes.set_ylabel("magnitude")
        axes.set_ylim(1e-3, None)
    closed.set_ylim(1e-3, 1e2)
    closed.set_xlabel("frequency (Hz)")
    for axes in gain, phase, closed:
        axes.grid(True, which="both", alpha=0.3)
        axes.legend()
    figure.savefig(path, dpi=120)


def draw_nyquist(path, plant, controller, gain_spread):
    """Open loop in the complex plane, nominal and at both ends of the gain's spread.

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

    figure = Figure(figsize=(7, 7), layout="constrained")
    axes = figure.subplots()
    axes.plot(turn.real, turn.imag, color="0.7", label="unit circle")
    circle = -1 + turn / peak
    axes.plot(circle.real, circle.imag, ":", label=f"peak sensitivity {peak:.2f}")
    for gain in 1 - gain_spread, 1, 1 + gain_spread:
        axes.plot(gain * loop.real, gain * loop.imag, label=f"open loop, gain {gain:.2f}",
                  alpha=1.0 if gain == 1 else 0.5)
    axes.plot(-1, 0, "k+", markersize=12)
    axes.set(xlim=(-3, 1.5), ylim=(-2.25, 2.25), xlabel="real", ylabel="imaginary", aspect="equal")
    axes.grid(True, alpha=0.3)
    axes.legend(loc="lower right")
    figure.savefig(path, dpi=120)


def draw_weights(path, weights):
    """The weights over frequency.

    Parameters
    ----------
    path : path-like
        PNG to write.
    weights : DesignWeights
    """
    tick_s = weights.sample_period_s
    frequency_hz = _frequencies(tick_s)
    figure = Figure(figsize=(8, 5), layout="constrained")
    axes = figure.subplots()
    for name, label in (("performance", "w$_1$, error (1/um)"),
                        ("control", "w$_2$, feedback voltage (1/V)"),
                        ("disturbance", "w$_d$, disturbance (um)"),
                        ("noise", "w$_n$, noise (um)"),
                        ("reference", "w$_r$, reference (um)")):
        axes.loglog(frequency_hz, _size(getattr(weights, name), frequency_hz, tick_s), label=label)
    for value, label in ((weights.feedforward_error, "w$_\\delta$, error of the feedforward"),
                         (weights.hysteresis_uncertainty, "w$_u$, gain of the hysteresis")):
        axes.axhline(value, color="0.4", linestyle="--" if value < 0.1 else ":", label=label)
    axes.set(xlabel="frequency (Hz)", ylabel="magnitude", ylim=(LOWEST_WEIGHT, None))
    axes.grid(True, which="both", alpha=0.3)
    axes.legend(ncols=2)
    figure.savefig(path, dpi=120)


def draw_mu(path, frequency_hz, mu, history):
    """Structured singular value over frequency, and its peak from iterate to iterate.

    Parameters
    ----------
    path : path-like
        PNG to write.
    frequency_hz, mu : ndarray, shape (F,)
        Of the final controller; zero frequency is left out.
    history : list of float
    """
    figure = Figure(figsize=(8, 4), layout="constrained")
    over_frequency, over_iterates = figure.subplots(1, 2, sharey=True, width_ratios=(2, 1))
    over_frequency.semilogx(frequency_hz[frequency_hz > 0], mu[frequency_hz > 0])
    over_frequency.axhline(mu.max(), color="0.5", linestyle=":", label=f"peak {mu.max():.3f}")
    over_frequency.set(xlabel="frequency (Hz)", ylabel="structured singular value",
                       ylim=(0, 1.05 * max(*history, mu.max())))
    over_frequency.legend()
    over_iterates.plot(np.arange(1, len(history) + 1), history, "o-")
    over_iterates.set(xlabel="synthesis")
    for axes in over_frequency, over_iterates:
        axes.grid(True, alpha=0.3)
    figure.savefig(path, dpi=120)


def _size(weight, frequency_hz, tick_s):
    points = np.exp(2j * np.pi * frequency_hz * tick_s)
    return np.abs(weight.state_space(tick_s)(points, squeeze=True)) * np.ones_like(frequency_hz)


def _frequencies(tick_s):
    return np.geomspace(LOWEST_HZ, 0.5 / tick_s, 2000)
