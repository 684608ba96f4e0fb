# SPDX-License-Identifier: BSD-3-Clause
"""PID and PI feedback by the rules of Ziegler and Nichols (thesis 2.4.2 and 3.3.3)."""

from dataclasses import dataclass

import control
import numpy as np
from numpy.typing import ArrayLike

from piezo_models.cascade import StageModel
from piezo_models.linear.dynamics import continue_linear, zoh

RELAY_SWING = 0.9
"""Swing of the relay as a part of the model's range. With a small one the hysteresis has less
gain, and the ultimate gain comes out so high that large amplitudes oscillate."""
RELAY_CYCLES = 30
LONGEST_CYCLE_TICKS = 4000
FREQUENCIES = 20000
DERIVATIVE_LAG_PERIODS = 2.5
"""Lag of the derivative in ultimate periods; (2.31) has 0.005 s at a period of 0.002 s."""


class NoOscillation(ValueError):
    """A loop without an ultimate point."""


@dataclass(frozen=True)
class UltimatePoint:
    """Gain and period at which a proportional feedback oscillates."""

    gain: float
    """Ultimate gain (V/um)."""
    period_s: float


def ultimate_point_by_relay(model: StageModel, samples_per_tick: int, clock_period_s: float,
                            swing: float = RELAY_SWING) -> UltimatePoint:
    """Determine the ultimate point by a relay in a loop with the model, as in thesis 2.4.2.

    The relay switches about the middle of the travel, once per tick, by the mean known at that
    time. Its peak-to-peak swing is a part of the model's range. The point follows from the relay's
    describing function. Raises `NoOscillation` if the relay does not settle to a cycle.
    """
    hysteresis = model.hysteresis
    middle_v = (hysteresis.voltage_min_v + hysteresis.voltage_max_v) / 2
    amplitude_v = swing * (hysteresis.voltage_max_v - middle_v)
    memory = model.memory(middle_v)
    past, state = memory.hysteresis, memory.linear_state
    system = zoh(model.linear(), clock_period_s)
    at_rest_um, _ = continue_linear(system, hysteresis.simulate(np.array([middle_v]), past), state)
    middle_um = float(at_rest_um[0])
    voltages_v, means_um = [middle_v + amplitude_v], [middle_um]
    rises = []
    for tick in range(RELAY_CYCLES * LONGEST_CYCLE_TICKS):
        held_v = np.full(samples_per_tick, voltages_v[-1])
        displacement_um, state = continue_linear(
            system, hysteresis.simulate(held_v, past), state)
        # A measurement in this tick is answered two ticks later.
        above = means_um[-1] > middle_um
        means_um.append(float(displacement_um.mean()))
        voltages_v.append(middle_v - amplitude_v if above else middle_v + amplitude_v)
        if voltages_v[-1] > voltages_v[-2]:
            rises.append(tick)
        if len(rises) > RELAY_CYCLES:
            break
        if tick - (rises[-1] if rises else 0) > LONGEST_CYCLE_TICKS:
            raise NoOscillation("the relay does not oscillate with the model: "
                                "its swing does not carry the stage across mid-travel")
    cycles = RELAY_CYCLES // 2
    settled = slice(rises[-1 - cycles] + 1, rises[-1] + 1)
    swing_um = np.ptp(means_um[settled])
    period_s = (rises[-1] - rises[-1 - cycles]) / cycles * samples_per_tick * clock_period_s
    return UltimatePoint(float(8 * amplitude_v / (np.pi * swing_um)), float(period_s))


def ultimate_point_by_response(plant: control.StateSpace,
                               largest_gain_um_per_v: float) -> UltimatePoint:
    """Determine the ultimate point from the linear dynamics, corrected for the hysteresis' gain.

    By (3.18) and (3.19) the period is that at which the phase crosses -180 degrees, and the gain is
    the gain margin there, divided by the largest gain of the hysteresis, Delta_max of (3.16). The
    plant leads from the hysteresis' output to the known displacement. Raises `NoOscillation` if the
    phase never crosses -180 degrees.
    """
    frequency_hz = np.geomspace(1e-3, 1.0, FREQUENCIES) * 0.5 / plant.dt
    response = plant(np.exp(2j * np.pi * frequency_hz * plant.dt), squeeze=True)
    phase_rad = np.unwrap(np.angle(response))
    beyond = np.flatnonzero(phase_rad <= -np.pi)
    if not beyond.size:
        raise NoOscillation("the phase of the model never crosses -180 degrees below half the "
                            "feedback's rate: there is no ultimate gain")
    ultimate_hz = np.interp(np.pi, -phase_rad, frequency_hz)
    margin = 1 / np.abs(plant(np.exp(2j * np.pi * ultimate_hz * plant.dt), squeeze=True))
    return UltimatePoint(float(margin / largest_gain_um_per_v), float(1 / ultimate_hz))


def pid(ultimate: UltimatePoint, tick_s: float) -> control.StateSpace:
    """Return a PID from error (um) to voltage (V) by the rule of Ziegler and Nichols.

    It is 0.6 Ku (1 + 2 / (Tu s) + Tu s / 8), (2.31), with a lag on the derivative, discretised by
    Tustin's rule.
    """
    gain, period_s = ultimate.gain, ultimate.period_s
    lag_s = DERIVATIVE_LAG_PERIODS * period_s
    integral = _tustin([[0.0]], [[1.0]], [[2 / period_s]], [[0.0]], tick_s)
    rate = period_s / 8 / lag_s
    derivative = _tustin([[-1 / lag_s]], [[1 / lag_s]], [[-rate]], [[rate]], tick_s)
    return 0.6 * gain * (1 + integral + derivative)


def proportional_integral(ultimate: UltimatePoint, tick_s: float) -> control.StateSpace:
    """Return a PI from error (um) to voltage (V), 0.6 Ku (1 + 2 / (Tu s)), (3.20)."""
    integral = _tustin([[0.0]], [[1.0]], [[2 / ultimate.period_s]], [[0.0]], tick_s)
    return 0.6 * ultimate.gain * (1 + integral)


def _tustin(a: ArrayLike, b: ArrayLike, c: ArrayLike, d: ArrayLike,
            tick_s: float) -> control.StateSpace:
    return control.ss(a, b, c, d).sample(tick_s, method="bilinear")
