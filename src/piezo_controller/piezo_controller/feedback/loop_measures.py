# SPDX-License-Identifier: BSD-3-Clause
"""Performance of a feedback loop: bandwidth, margins, settling."""

from dataclasses import dataclass
from typing import Any

import control
import numpy as np

from piezo_common.arrays import BoolArray, ComplexArray, FloatArray
from piezo_controller.feedback.synthesis.h_infinity import is_stable
from piezo_controller.feedback.synthesis.structured_singular_value import sampled_response

BAND_EDGE = 1 / np.sqrt(2)
SETTLED = 0.05
LONGEST_SETTLING_TICKS = 2000
LEAST_CROSSING = 1e-12
"""Magnitude of a loop on the real axis below which a crossing is due to rounding."""


@dataclass(frozen=True)
class Margins:
    """Distances of a loop from instability, and the frequencies at which they occur."""

    gain: float | None = None
    """Factor by which the gain may rise; None if the loop does not cross the real axis between -1
    and 0."""
    gain_hz: float | None = None
    """Frequency of that crossing."""
    phase_deg: float | None = None
    """Angle by which the phase may fall; None if the loop does not cross the unit circle."""
    phase_hz: float | None = None
    """Frequency of that crossing."""


def loop_responses(plant: control.StateSpace, controller: control.StateSpace,
                   frequency_hz: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Return the responses of the open loop, ``L = G K``, and of its sensitivity, ``1 / (1 + L)``.

    Plant and controller are discrete, with one input and one output.
    """
    points = np.exp(2j * np.pi * np.asarray(frequency_hz) * plant.dt)
    loop = (plant(points, squeeze=False) * controller(points, squeeze=False))[0, 0]
    return loop, 1 / (1 + loop)


def measure_loop(plant: control.StateSpace, controller: control.StateSpace,
                 gain_spread: float) -> dict[str, float | None]:
    """Measure a closed loop, in which the plant's output is fed back negatively to the controller.

    The plant's gain may lie within ``1 +- gain_spread`` of its nominal value. Measured are
    ``bandwidth_hz`` (where the sensitivity first reaches -3 dB), ``crossover_hz`` (where the open
    loop first falls to 1), ``peak_sensitivity`` and its ``peak_frequency_hz``, ``gain_margin`` and
    ``phase_margin_deg`` with ``_at_lowest_gain`` and ``_at_highest_gain``,
    ``settling_to_5_percent_s`` (after a step disturbance of the output), and
    ``stable_within_gain_spread``. None if the loop has no such value: it crosses nothing from 0.1
    Hz on, or has not settled after `LONGEST_SETTLING_TICKS`.
    """
    frequency_hz = _frequencies(plant.dt)
    loop, sensitivity = loop_responses(plant, controller, frequency_hz)
    size = np.abs(sensitivity)
    gains = np.linspace(1 - gain_spread, 1 + gain_spread, 5)
    measures = {
        "bandwidth_hz": _first_rise_hz(frequency_hz, size > BAND_EDGE),
        "crossover_hz": _first_rise_hz(frequency_hz, np.abs(loop) < 1),
        "peak_sensitivity": float(size.max()),
        "peak_frequency_hz": float(frequency_hz[size.argmax()]),
        "settling_to_5_percent_s": _settling_s(plant, controller),
        "stable_within_gain_spread": all(
            is_stable(control.feedback(gain * plant * controller, 1)) for gain in gains),
    }
    for where, gain in (("", 1.0), ("_at_lowest_gain", gains[0]), ("_at_highest_gain", gains[-1])):
        margins = margins_of(frequency_hz, gain * loop)
        measures["gain_margin" + where] = margins.gain
        measures["phase_margin_deg" + where] = margins.phase_deg
    return measures


def sensitivity_of_axes(plant: control.StateSpace, controller: control.StateSpace,
                        frequency_hz: FloatArray) -> ComplexArray:
    """Return the response of the sensitivity of several axes, shape (F, n, n)."""
    points = np.exp(2j * np.pi * frequency_hz * plant.dt)
    loop = sampled_response(plant, points) @ sampled_response(controller, points)
    return np.asarray(np.linalg.inv(np.eye(plant.noutputs) + loop), dtype=complex)


def measure_axes_loop(plant: control.StateSpace, controller: control.StateSpace,
                      axes: tuple[str, ...]) -> dict[str, Any]:
    """Measure the closed loop of several axes.

    Measured are ``bandwidth_hz`` (where the largest singular value of the sensitivity first reaches
    -3 dB), ``bandwidth_hz_of_axis`` (where the sensitivity of each axis to its own disturbance
    does), ``peak_sensitivity`` (the largest singular value) and its ``peak_frequency_hz``; and what
    this peak guarantees, with gains or phases that change independently at the sensors:
    ``gain_margin`` and ``phase_margin_deg``.
    """
    frequency_hz = _frequencies(plant.dt)
    sensitivity = sensitivity_of_axes(plant, controller, frequency_hz)
    size = np.linalg.norm(sensitivity, 2, axis=(1, 2))
    own = np.abs(np.diagonal(sensitivity, axis1=1, axis2=2))
    peak = float(size.max())
    return {
        "bandwidth_hz": _first_rise_hz(frequency_hz, size > BAND_EDGE),
        "bandwidth_hz_of_axis": {
            axis: _first_rise_hz(frequency_hz, column > BAND_EDGE)
            for axis, column in zip(axes, own.T, strict=True)},
        "peak_sensitivity": peak, "peak_frequency_hz": float(frequency_hz[size.argmax()]),
        "gain_margin": peak / (peak - 1.0) if peak > 1.0 else None,
        "phase_margin_deg": float(np.degrees(2.0 * np.arcsin(min(0.5 / peak, 1.0)))),
    }


def _first_rise_hz(frequency_hz: FloatArray, holds: BoolArray) -> float | None:
    """Return the first frequency at which a condition begins to hold; None if it never does."""
    begins = np.flatnonzero(~holds[:-1] & holds[1:])
    return float(frequency_hz[begins[0] + 1]) if begins.size else None


def loop_margins(plant: control.StateSpace, controller: control.StateSpace) -> Margins:
    """Return the margins of a loop, as `measure_loop` measures them at the nominal gain."""
    frequency_hz = _frequencies(plant.dt)
    return margins_of(frequency_hz, loop_responses(plant, controller, frequency_hz)[0])


def _frequencies(tick_s: float) -> FloatArray:
    return np.geomspace(0.1, 0.5 / tick_s, 8000)


def margins_of(frequency_hz: FloatArray, loop: ComplexArray) -> Margins:
    """Return the margins of a loop from a dense frequency response up to half the tick rate, (F,).

    The gain margin is that for rising gain: only crossings between -1 and 0 count.
    """
    real, imaginary, size = loop.real, loop.imag, np.abs(loop)
    crossing = np.flatnonzero(imaginary[:-1] * imaginary[1:] < 0)
    unity = np.flatnonzero((size[:-1] - 1) * (size[1:] - 1) < 0)
    # At half the tick rate, the last frequency, the response is real.
    crossing = np.append(crossing, real.size - 1)
    crossing = crossing[(real[crossing] > -1) & (real[crossing] < -LEAST_CROSSING)]
    gain = gain_hz = phase_deg = phase_hz = None
    if crossing.size:
        nearest = crossing[np.argmin(real[crossing])]
        gain, gain_hz = float(-1 / real[nearest]), float(frequency_hz[nearest])
    if unity.size:
        nearest = unity[np.argmax(np.abs(np.angle(loop[unity])))]
        phase_deg = float(np.degrees(np.pi - np.abs(np.angle(loop[nearest]))))
        phase_hz = float(frequency_hz[nearest])
    return Margins(gain, gain_hz, phase_deg, phase_hz)


def _settling_s(plant: control.StateSpace, controller: control.StateSpace) -> float | None:
    sensitivity = control.feedback(1, plant * controller)
    time_s = np.arange(LONGEST_SETTLING_TICKS) * plant.dt
    error = np.abs(control.step_response(sensitivity, time_s).outputs)
    outside = np.flatnonzero(error > SETTLED)
    if outside.size and outside[-1] == error.size - 1:
        return None
    return float((outside[-1] + 1) * plant.dt) if outside.size else 0.0
