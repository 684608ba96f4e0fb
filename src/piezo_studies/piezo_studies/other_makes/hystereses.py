# SPDX-License-Identifier: BSD-3-Clause
"""Hystereses of other forms than relays: plays between curves, Maxwell's slip, equations.

Each is a function of a voltage (N,) that begins at 0 V on a stage that was never cycled. It returns
the input of the linear part (um), shape (N,). All are independent of time.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit

from piezo_common.arrays import FloatArray

Hysteresis = Callable[[FloatArray], FloatArray]
"""A function from the history of the voltage to a displacement."""


@dataclass(frozen=True)
class Plays:
    """A sum of plays, whose two sides are different curves of the voltage."""

    half_widths_v: FloatArray
    """Shape (P,)."""
    weights_um_per_v: FloatArray
    """Shape (P,)."""
    rising: tuple[float, ...]
    falling: tuple[float, ...]
    """Polynomial coefficients of the curves of the two sides, from the first power on."""

    def __call__(self, voltage_v: FloatArray) -> FloatArray:
        """Return the input of the linear part (um), shape (N,)."""
        rising, falling = (np.asarray(
            np.polynomial.polynomial.polyval(voltage_v, (0.0, *side)), dtype=float)
            for side in (self.rising, self.falling))
        return _plays(rising, falling, self.half_widths_v, self.weights_um_per_v)


@njit(cache=True)
def _plays(rising: FloatArray, falling: FloatArray, half_widths: FloatArray,
           weights: FloatArray) -> FloatArray:
    driven = np.zeros(rising.size)
    states = np.zeros(half_widths.size)
    for n in range(rising.size):
        for p in range(half_widths.size):
            states[p] = max(rising[n] - half_widths[p],
                            min(falling[n] + half_widths[p], states[p]))
            driven[n] += weights[p] * states[p]
    return driven


@dataclass(frozen=True)
class MaxwellSlip:
    """A spring in parallel with massless blocks on springs that slip at different forces.

    Goldfarb and Celanovic (1997). The displacement is that without blocks, less the part that the
    blocks hold back.
    """

    gain_um_per_v: float

    stiffnesses_um_per_v: FloatArray
    """Shape (B,)."""
    limits_v: FloatArray
    """Change of the voltage after which a block slips, (B,)."""
    curvature_per_v: float = 0.0
    """Relative change of the gain with the voltage."""

    def __call__(self, voltage_v: FloatArray) -> FloatArray:
        """Return the input of the linear part (um), shape (N,)."""
        free_um = self.gain_um_per_v * voltage_v * (1.0 + self.curvature_per_v * voltage_v)
        return free_um - _blocks(voltage_v, self.stiffnesses_um_per_v, self.limits_v)


@njit(cache=True)
def _blocks(voltage: FloatArray, stiffnesses: FloatArray, limits: FloatArray) -> FloatArray:
    held = np.zeros(voltage.size)
    stretched = np.zeros(limits.size)
    before = 0.0
    for n in range(voltage.size):
        for b in range(limits.size):
            stretched[b] = min(max(stretched[b] + voltage[n] - before, -limits[b]), limits[b])
            held[n] += stiffnesses[b] * stretched[b]
        before = voltage[n]
    return held


@dataclass(frozen=True)
class Duhem:
    """The equation of Coleman and Hodgdon, ``s' = rate v' + slope |v'| (middle v - s)``."""

    direct_um_per_v: float
    state_um_per_v: float
    """Factors of voltage and state in the displacement."""
    rate: float
    slope_per_v: float
    middle: float

    def __call__(self, voltage_v: FloatArray) -> FloatArray:
        """Return the input of the linear part (um), shape (N,)."""
        state = _duhem(voltage_v, self.rate, self.slope_per_v, self.middle)
        return self.direct_um_per_v * voltage_v + self.state_um_per_v * state


@njit(cache=True)
def _duhem(voltage: FloatArray, rate: float, slope: float, middle: float) -> FloatArray:
    # Between two voltages, the solution is a line plus an exponential.
    states = np.empty(voltage.size)
    state, before = 0.0, 0.0
    for n in range(voltage.size):
        way = voltage[n] - before
        sign = 1.0 if way > 0.0 else -1.0
        lag = (middle - rate) * sign / slope
        state = (middle * voltage[n] - lag
                 + (state - middle * before + lag) * np.exp(-slope * abs(way)))
        before = voltage[n]
        states[n] = state
    return states


@dataclass(frozen=True)
class JilesAtherton:
    """Pinned domain walls (Jiles and Atherton, 1986) about a polarised state."""

    gain_um_per_v: float
    saturation_um: float
    """Linear gain, and the largest displacement of the domains."""
    shape_v: float
    pinning_v: float
    """Width of the anhysteretic curve, and width of the loops."""
    coupling_v_per_um: float
    reversible: float
    """Coupling field of the domains, and fraction of them that moves reversibly."""
    middle_v: float
    """Voltage about which the curves are odd functions."""

    def __call__(self, voltage_v: FloatArray) -> FloatArray:
        """Return the input of the linear part (um), shape (N,)."""
        return self.gain_um_per_v * voltage_v + _domains(
            voltage_v - self.middle_v, -self.middle_v, self.saturation_um, self.shape_v,
            self.pinning_v, self.coupling_v_per_um, self.reversible)


@njit(cache=True)
def _langevin(field: float) -> float:
    if abs(field) < 1e-3:
        return field / 3.0
    return 1.0 / np.tanh(field) - 1.0 / field


@njit(cache=True)
def _slope(pinned: float, voltage: float, sign: float, saturation: float, shape: float,
           pinning: float, coupling: float) -> float:
    aimed = saturation * _langevin((voltage + coupling * pinned) / shape)
    missing = aimed - pinned
    # Walls never move against the voltage.
    return 0.0 if missing * sign <= 0.0 else missing / (pinning * sign - coupling * missing)


@njit(cache=True)
def _domains(voltage: FloatArray, before: float, saturation: float, shape: float, pinning: float,
             coupling: float, reversible: float) -> FloatArray:
    longest = 0.02 * pinning
    moved = np.empty(voltage.size)
    pinned = 0.0
    for n in range(voltage.size):
        way = voltage[n] - before
        parts = int(abs(way) / longest) + 1
        step, sign = way / parts, 1.0 if way > 0.0 else -1.0
        for _ in range(parts if way != 0.0 else 0):
            halfway = pinned + 0.5 * step * _slope(
                pinned, before, sign, saturation, shape, pinning, coupling)
            pinned += step * _slope(
                halfway, before + 0.5 * step, sign, saturation, shape, pinning, coupling)
            before += step
        before = voltage[n]
        aimed = saturation * _langevin((voltage[n] + coupling * pinned) / shape)
        moved[n] = (1.0 - reversible) * pinned + reversible * aimed
    return moved
