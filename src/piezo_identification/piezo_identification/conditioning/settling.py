# SPDX-License-Identifier: BSD-3-Clause
"""Settling time and low-frequency delay of the electric and vibration dynamics."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, TypeGuard

import control
import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import lfilter

from piezo_common.arrays import BoolArray, ComplexArray, FloatArray
from piezo_identification.conditioning.waveforms import jumps_of, longest_run
from piezo_models.effects.delay import Delay
from piezo_models.effects.effect import Effect
from piezo_models.effects.lag import Lag
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.linear.dynamics import ElectricVibrationDynamics, zoh

NEGLIGIBLE = 1e-5
"""Fraction of a step below which its ringing is negligible."""

UNRESOLVED = 0.01
"""The same in rows too slow for it, which show it with an error of about a hundredth."""

SMALL_PART = 0.01
"""Participation below which the ringing of a mode is not waited for, as its mean is correct."""

USUAL_SETTLING_S = 0.03
"""Time omitted after a step if the electric and vibration dynamics are not known."""

RINGING = 0.5
"""Damping ratio below which a mode rings."""

SLOWER_THAN_MODES = 0.2
"""Fraction of the frequency of a ringing mode below which other poles are creep."""

STANDS_OUT = 0.1
"""Product of participation, frequency and quality factor, relative to that of the mode that stands
out most, from which a slower mode is believed. For a lag: the speed after a step, relative to that
of the modes."""

MOST_OF_RECORDING = 0.25
"""Largest fraction of a recording that is excluded while it settles, however slowly a mode
decays."""


@dataclass(frozen=True)
class SlowDynamics(ElectricVibrationDynamics):
    """Electric and vibration dynamics with further parallel modes that have to settle."""

    parallel_modes: tuple[VibrationMode, ...] = ()
    """Parallel modes; the participation of each is taken from the modes in series."""

    @property
    def is_static(self) -> bool:
        """Whether there is neither a lag nor a mode."""
        return super().is_static and not self.parallel_modes

    def state_space(self, parallel_modes: Sequence[Any] = ()) -> control.StateSpace:
        """Return the continuous state space, including the modes in `parallel_modes`."""
        return super().state_space((*self.parallel_modes, *parallel_modes))

    def response(self, frequency_hz: ArrayLike, parallel_modes: Sequence[Any] = ()) -> ComplexArray:
        """Return the complex response at frequencies, in their shape; see `state_space`."""
        return super().response(frequency_hz, (*self.parallel_modes, *parallel_modes))


def low_frequency_delay_s(dynamics: ElectricVibrationDynamics) -> float:
    """Return the delay of the dynamics at low frequency, the coefficient of (4.18) and (4.19).

    It is tau + sum 2 d / w over the modes, less the same sum over the antiresonances. Each parallel
    mode delays only its part of the displacement.
    """
    def sum_of_modes(frequencies: Sequence[float], dampings: Sequence[float]) -> float:
        return sum(2.0 * d / w for w, d in zip(frequencies, dampings, strict=True))

    in_series_s = (
        sum_of_modes(dynamics.mode_frequencies_rad_per_s, dynamics.damping_ratios)
        - sum_of_modes(dynamics.antiresonance_frequencies_rad_per_s,
                       dynamics.antiresonance_damping_ratios)
    )
    parallel_modes = dynamics.parallel_modes if isinstance(dynamics, SlowDynamics) else ()
    return dynamics.time_constant_s + in_series_s + sum(
        _delay_of_mode_s(mode, in_series_s) for mode in parallel_modes)


def _delay_of_mode_s(mode: VibrationMode, in_series_s: float) -> float:
    """Return the delay that a parallel mode adds to that of the modes in series."""
    return mode.branch_delay_s() - mode.participation * in_series_s


def held_delay_s(dynamics: ElectricVibrationDynamics, sample_period_s: float) -> float:
    """Return the delay at low frequency from held voltages to samples read before they change.

    It is -H'(1) sample periods for H(z) = C (zI - A)^-1 B + D, which includes the hold. If the
    dynamics are slow compared with the period, it is `low_frequency_delay_s` plus half a period; if
    they are fast, it is a whole period.
    """
    system = zoh(dynamics.state_space(), sample_period_s)
    away = np.eye(system.nstates) - system.A
    slope = system.C @ np.linalg.solve(away, np.linalg.solve(away, system.B))
    return sample_period_s * float(slope[0, 0])


def slow_dynamics(
    dynamics: ElectricVibrationDynamics, effects: Sequence[Effect],
) -> SlowDynamics:
    """Return the dynamics with all modes that have to settle.

    Of the effects, parallel modes with a notable participation are included.
    """
    own = {each.name: getattr(dynamics, each.name) for each in fields(ElectricVibrationDynamics)}
    return SlowDynamics(
        **own, parallel_modes=tuple(effect for effect in effects if _has_to_settle(effect)))


def slow_delay_s(dynamics: ElectricVibrationDynamics, effects: Sequence[Effect]) -> float:
    """Return the delay of slow signals from effects, in addition to that of `slow_dynamics`.

    Delays, lags of amplifier or sensor, and small parallel modes count.
    """
    in_series_s = low_frequency_delay_s(dynamics) - dynamics.time_constant_s
    delay_s = 0.0
    for effect in effects:
        if isinstance(effect, Delay):
            delay_s += effect.delay_s
        elif isinstance(effect, Lag):
            delay_s += effect.slow_delay_s
        elif isinstance(effect, VibrationMode) and not _has_to_settle(effect):
            delay_s += _delay_of_mode_s(effect, in_series_s)
    return delay_s


def _has_to_settle(effect: Effect) -> TypeGuard[VibrationMode]:
    return isinstance(effect, VibrationMode) and abs(effect.participation) > SMALL_PART


def settling_time_s(dynamics: ElectricVibrationDynamics) -> float:
    """Return the time after which the response to a step has settled.

    Poles with a small share of that response, as of a mode near an antiresonance, do not count.
    Those that hardly stand out, far slower than the mode that does most, are waited for no longer
    than usual: they are creep, or errors of loops.
    """
    if dynamics.is_static:
        return 0.0
    system = dynamics.state_space()
    poles, directions = np.linalg.eig(system.A)
    shares = np.abs(
        (system.C @ directions)[0] * np.linalg.solve(directions, system.B)[:, 0] / poles)
    # The two poles of a mode share its participation.
    is_notable = 2.0 * shares > SMALL_PART
    all_s, clear_s = (-np.log(NEGLIGIBLE) / (-poles.real[counted]).min(initial=np.inf)
                      for counted in (is_notable, is_notable & _stand_out(poles, shares)))
    return float(max(clear_s, min(all_s, USUAL_SETTLING_S)))


def _stand_out(poles: ComplexArray, shares: FloatArray) -> BoolArray:
    """Return which poles are no creep and no error of loops, (n,)."""
    rates_rad_per_s, frequencies = -poles.real, np.abs(poles)
    rings = rates_rad_per_s < RINGING * frequencies
    speeds = shares * frequencies
    heights = np.where(rings, speeds * frequencies / rates_rad_per_s, 0.0)
    slowest = SLOWER_THAN_MODES * frequencies[np.argmax(heights)] if rings.any() else 0.0
    # A lag that drives the modes moves as fast as they do.
    is_lag = ~rings & (speeds >= STANDS_OUT * 2.0 * speeds.max(where=rings, initial=0.0))
    found: BoolArray = (
        (frequencies >= slowest) | (heights >= STANDS_OUT * heights.max()) | is_lag)
    return found


def rings_unresolved(dynamics: ElectricVibrationDynamics, voltage_v: FloatArray,
                     sample_period_s: float) -> BoolArray:
    """Mark the rows, (N,), in which a mode rings after a jump that is too fast for the rows.

    Its phase in such a row depends on what a slow recording cannot show, such as the shape of a lag
    in front of the hysteresis. The dynamics contain all modes that have to settle. No row is marked
    if the rows resolve the modes. At most `MOST_OF_RECORDING` of the longest run between two jumps
    is marked after each of them.
    """
    rows = np.arange(voltage_v.size)
    jumps = jumps_of(voltage_v)
    if not jumps.size or not _unresolved_poles(dynamics, sample_period_s).size:
        return np.zeros(rows.size, dtype=bool)
    settling_s = settling_time_s(dynamics) * np.log(UNRESOLVED) / np.log(NEGLIGIBLE)
    settled = min(settling_s / sample_period_s, MOST_OF_RECORDING * longest_run(voltage_v))
    last = np.concatenate([[-np.inf], jumps])[np.searchsorted(jumps, rows, side="right")]
    return np.asarray((rows > last) & (rows - last <= settled))


def unresolved_ringing(dynamics: ElectricVibrationDynamics, voltage_v: FloatArray,
                       sample_period_s: float) -> FloatArray:
    """Return the ringing of modes after jumps that is too fast for the rows, (N, k).

    Two signals for each mode, of which any sum has the right frequency and damping, leave its
    amplitude and phase free; see `rings_unresolved`. There are none without jumps.
    """
    jumps = jumps_of(voltage_v)
    jumped_v = np.zeros(voltage_v.size, dtype=complex)
    jumped_v[jumps] = np.diff(voltage_v)[jumps - 1]
    poles = _unresolved_poles(dynamics, sample_period_s) if jumps.size else np.empty(0)
    signals = [lfilter([0.0, 1.0], [1.0, -np.exp(pole * sample_period_s)], jumped_v)
               for pole in poles]
    return np.column_stack([np.empty((voltage_v.size, 0)), *(
        part for signal in signals for part in (signal.real, signal.imag))])


def _unresolved_poles(dynamics: ElectricVibrationDynamics,
                      sample_period_s: float) -> ComplexArray:
    """Return the poles of modes that ring, if the rows resolve none of the modes, (k,)."""
    poles = dynamics.state_space().poles()
    poles = poles[poles.imag > 0.0]
    is_resolved = sample_period_s * np.abs(poles).min(initial=np.inf) < 1.0
    return np.asarray(poles[:0] if is_resolved else poles)


def first_settled(dynamics: ElectricVibrationDynamics, time_s: FloatArray,
                  effects: Sequence[Effect] = ()) -> int:
    """Find the first sample of a recording after its start has settled, by its times, (N,).

    At most the fraction `MOST_OF_RECORDING` of the recording is excluded. Parallel modes and lags
    among the effects have to settle, too.
    """
    if not isinstance(dynamics, SlowDynamics):
        dynamics = slow_dynamics(dynamics, effects)
    longest_lag_s = max((effect.time_constant_s for effect in effects
                         if isinstance(effect, Lag)), default=0.0)
    settled = int(np.searchsorted(
        time_s, max(settling_time_s(dynamics), -np.log(NEGLIGIBLE) * longest_lag_s)))
    return min(settled, int(MOST_OF_RECORDING * time_s.size))
