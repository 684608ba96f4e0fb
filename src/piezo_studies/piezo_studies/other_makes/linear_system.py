# SPDX-License-Identifier: BSD-3-Clause
"""Linear systems as sums over poles: lags, modes, creep by a continuum of rates, flexures."""

from collections.abc import Callable
from dataclasses import dataclass, field
from math import gamma
from typing import Any, Self

import numpy as np
from numba import njit

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_studies.other_makes.hystereses import Hysteresis

RATES_PER_DECADE = 4
"""Rates per decade that represent a continuum; the trapezoidal rule is then exact to 1e-7."""

SMALL = 1e-3
"""Product of step and pole below which a series replaces a difference of exponentials."""


@dataclass(frozen=True)
class LinearSystem:
    """A transfer function with a direct part and a sum of residues / (s - poles)."""

    poles_per_s: ComplexArray
    """Distinct poles, (P,); one of each conjugate pair."""
    residues: ComplexArray
    """Shape (P,)."""
    direct: float = 0.0

    def at(self, s: complex | ComplexArray) -> Any:
        """Return the transfer function at complex frequencies (rad/s), in their shape."""
        s = np.asarray(s, dtype=complex)[..., None]
        paired = self.poles_per_s.imag != 0.0
        return self.direct + (
            self.residues / (s - self.poles_per_s)
            + paired * self.residues.conj() / (s - self.poles_per_s.conj())).sum(axis=-1)

    def then(self, following: Self) -> Self:
        """Return the two systems in series; they must have no pole in common."""
        return type(self)(
            np.append(self.poles_per_s, following.poles_per_s),
            np.append(self.residues * following.at(self.poles_per_s),
                      following.residues * self.at(following.poles_per_s)),
            self.direct * following.direct)

    def parallel_to(self, other: Self) -> Self:
        """Return the two systems in parallel."""
        return type(self)(np.append(self.poles_per_s, other.poles_per_s),
                          np.append(self.residues, other.residues), self.direct + other.direct)

    def weights(self) -> ComplexArray:
        """Return the residues, doubled for pairs, so that the response is the sum's real part."""
        return np.where(self.poles_per_s.imag != 0.0, 2.0, 1.0) * self.residues


def unchanged() -> LinearSystem:
    """Return a system whose output equals its input."""
    return LinearSystem(np.empty(0, complex), np.empty(0, complex), 1.0)


def lag(time_constant_s: float, share: float = 1.0) -> LinearSystem:
    """Return a first-order lag."""
    return LinearSystem(np.array([-1.0 / time_constant_s + 0j]),
                        np.array([share / time_constant_s + 0j]))


def mode(frequency_hz: float, damping: float, share: float = 1.0) -> LinearSystem:
    """Return an oscillator with a damping ratio below one; the share is its static gain."""
    w = 2.0 * np.pi * frequency_hz
    damped = w * np.sqrt(1.0 - damping**2)
    return LinearSystem(np.array([-damping * w + 1j * damped]),
                        np.array([share * w**2 / (2j * damped)]))


def coupled_flexures(mass: FloatArray, damping: FloatArray, stiffness: FloatArray,
                     force: FloatArray, reading: FloatArray, direct: float) -> LinearSystem:
    """Return bodies on springs moved by a force, with a static gain of 1 including the direct part.

    The matrices are (B, B). The weights of the force on the bodies, and of the bodies in the
    sensor's reading, are (B,).
    """
    bodies = len(mass)
    a = np.block([[np.zeros((bodies, bodies)), np.eye(bodies)],
                  [-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damping)]])
    b = np.append(np.zeros(bodies), np.linalg.solve(mass, force))
    c = np.append(reading, np.zeros(bodies))
    poles, vectors = np.linalg.eig(a)
    residues = (c @ vectors) * np.linalg.solve(vectors, b.astype(complex))
    one_of_pair = poles.imag > 0.0
    system = LinearSystem(poles[one_of_pair], residues[one_of_pair])
    scale = (1.0 - direct) / system.at(0.0).real
    return LinearSystem(system.poles_per_s, scale * system.residues, direct)


def spectrum(share_of: Callable[[FloatArray], FloatArray], fastest_s: float,
             slowest_s: float) -> LinearSystem:
    """Return 1 plus a continuum of relaxations between two time constants.

    Their density is over the natural logarithm of their time constants (s).
    """
    count = round(RATES_PER_DECADE * np.log10(slowest_s / fastest_s)) + 1
    times_s = np.geomspace(fastest_s, slowest_s, count)
    shares = share_of(times_s) * np.log(slowest_s / fastest_s) / (count - 1)
    return LinearSystem((-1.0 / times_s).astype(complex), (shares / times_s).astype(complex), 1.0)


def logarithmic_creep(per_decade: float, fastest_s: float = 1e-3,
                      slowest_s: float = 1e6) -> LinearSystem:
    """Return creep by a constant fraction of the displacement per decade of time."""
    return spectrum(lambda times_s: np.full(times_s.size, per_decade / np.log(10.0)),
                    fastest_s, slowest_s)


def power_creep(share: float, exponent: float, fastest_s: float = 1e-4,
                slowest_s: float = 1e7) -> LinearSystem:
    """Return creep by a power of time, in which the displacement grows by `share` in 1 s.

    Relaxations faster than `fastest_s` are part of the direct gain.
    """
    def share_of(times_s: FloatArray) -> FloatArray:
        return share * exponent / gamma(1.0 - exponent) * times_s**exponent

    system = spectrum(share_of, fastest_s, slowest_s)
    half_step = 0.5 * np.log(10.0) / RATES_PER_DECADE
    faster = share_of(np.array([fastest_s * np.exp(-half_step)]))[0] / exponent
    return LinearSystem(system.poles_per_s, system.residues, 1.0 + faster)


def fractional_creep(share: float, time_s: float, order: float, fastest_s: float = 1e-5,
                     slowest_s: float = 1e6) -> LinearSystem:
    """Return 1 + share / (1 + (s T)^order), by the distribution of Cole and Cole (1941)."""
    def share_of(times_s: FloatArray) -> FloatArray:
        return share * np.sin(order * np.pi) / (2.0 * np.pi) / (
            np.cosh(order * np.log(times_s / time_s)) + np.cos(order * np.pi))

    return spectrum(share_of, fastest_s, slowest_s)


def knots_s(period_s: float, fastest_per_s: float, read_s: float) -> FloatArray:
    """Return increasing times within a row between which signals are approximated by lines.

    They include the time of the reading, are dense after the edge of the row, and sparse once the
    fastest pole before the hysteresis, 0 if there is none, has settled.
    """
    times = [0.0]
    if fastest_per_s > 0.0:
        step = FINEST / fastest_per_s
        while times[-1] + 1.5 * step < period_s:
            times.append(times[-1] + step)
            if times[-1] * fastest_per_s > DENSE:
                step *= GROWTH
    return np.unique([*times, read_s, period_s])


FINEST, DENSE, GROWTH = 0.03, 6.0, 1.25
"""First step and the time for which it is used, both times the fastest pole, and growth of later
steps."""


def held_response(system: LinearSystem, voltage_v: FloatArray, knots: FloatArray,
                  state: ComplexArray) -> tuple[FloatArray, ComplexArray]:
    """Return the exact response, (N, K), to a voltage held in each row, at the knots of the row.

    The state, (P,), is that before the first row; the one after the last row is returned with it.
    """
    if system.poles_per_s.size == 0:
        return np.repeat(system.direct * voltage_v[:, None], knots.size, axis=1), state
    kept = np.exp(np.multiply.outer(knots, system.poles_per_s))
    return _held(kept, (kept - 1.0) / system.poles_per_s, system.weights(), system.direct,
                 voltage_v, state)


def straight_response(system: LinearSystem, input_um: FloatArray, knots: FloatArray, read: int,
                      state: ComplexArray) -> tuple[FloatArray, ComplexArray]:
    """Return the exact response, (N,), to straight lines between the knots of each row.

    The input, (N, K), may jump between the last knot of a row and the first of the next one; at the
    first knot the response is read before the jump. The state, (P,), is that before the first row;
    the one after the last row is returned with it.
    """
    steps = np.diff(knots)[:, None]
    reached: ComplexArray = steps * system.poles_per_s
    kept = np.exp(reached)
    small = np.abs(reached) < SMALL
    safe = np.where(small, 1.0, reached)
    level: ComplexArray = np.multiply(steps, np.where(
        small, 1.0 + reached / 2.0 + reached**2 / 6.0, (kept - 1.0) / safe))
    slope: ComplexArray = np.multiply(steps, np.where(
        small, 0.5 + reached / 6.0 + reached**2 / 24.0, (kept - 1.0 - safe) / safe**2))
    return _straight(kept, level - slope, slope, system.weights(), system.direct, input_um, read,
                     state)


@njit(cache=True)
def _held(kept: ComplexArray, driven: ComplexArray, weights: ComplexArray, direct: float,
          voltage_v: FloatArray, state: ComplexArray) -> tuple[FloatArray, ComplexArray]:
    rows, knots, poles = voltage_v.size, kept.shape[0], state.size
    response = np.empty((rows, knots))
    state = state.copy()
    for n in range(rows):
        for k in range(knots):
            value = direct * voltage_v[n]
            for p in range(poles):
                value += (weights[p] * (kept[k, p] * state[p] + driven[k, p] * voltage_v[n])).real
            response[n, k] = value
        for p in range(poles):
            state[p] = kept[-1, p] * state[p] + driven[-1, p] * voltage_v[n]
    return response, state


@njit(cache=True)
def _straight(kept: ComplexArray, first: ComplexArray, second: ComplexArray,
              weights: ComplexArray, direct: float, signal: FloatArray, read: int,
              state: ComplexArray) -> tuple[FloatArray, ComplexArray]:
    rows, knots = signal.shape
    response = np.empty(rows)
    state = state.copy()
    for n in range(rows):
        for k in range(knots):
            if k == read:
                at = signal[max(n - 1, 0), knots - 1] if read == 0 else signal[n, k]
                value = direct * at
                for p in range(state.size):
                    value += (weights[p] * state[p]).real
                response[n] = value
            if k < knots - 1:
                for p in range(state.size):
                    state[p] = (kept[k, p] * state[p] + first[k, p] * signal[n, k]
                                + second[k, p] * signal[n, k + 1])
    return response, state


@dataclass(frozen=True)
class HeldVoltage:
    """A voltage that is held for a period in each row."""

    voltage_v: FloatArray
    """Shape (N,)."""
    period_s: float


@dataclass(frozen=True)
class Stage:
    """The cascade of a stage, which is independent of the models."""

    hysteresis: Hysteresis

    behind: LinearSystem
    """Creep, modes and lags after the hysteresis."""
    front: LinearSystem = field(default_factory=unchanged)
    """The amplifier, before the hysteresis."""
    delay_s: float = 0.0
    """Delay of the reading."""

    def displacement_um(self, past: list[HeldVoltage], played: HeldVoltage) -> FloatArray:
        """Return the displacement, (N,), at the times at which the voltages of rows change.

        The stage was never cycled and begins at rest at 0 V, before the past voltages.
        """
        late_rows = int(np.ceil(self.delay_s / played.period_s - 1e-9))
        read_s = max(late_rows * played.period_s - self.delay_s, 0.0)
        begun = HeldVoltage(np.append(np.full(late_rows, played.voltage_v[0]), played.voltage_v),
                       played.period_s)
        fastest_per_s = np.abs(self.front.poles_per_s).max(initial=0.0)
        pieces, knots, state = [], [], np.zeros(self.front.poles_per_s.size, complex)
        for each in (*past, begun):
            knots.append(knots_s(each.period_s, fastest_per_s,
                                 read_s if each is begun else 0.0))
            reached_v, state = held_response(self.front, each.voltage_v, knots[-1], state)
            pieces.append(reached_v)
        driven_um = self.hysteresis(np.concatenate([piece.ravel() for piece in pieces]))
        state, first = np.zeros(self.behind.poles_per_s.size, complex), 0
        for piece, instants in zip(pieces, knots, strict=True):
            part_um = driven_um[first : first + piece.size].reshape(piece.shape)
            first += piece.size
            read = int(np.argmin(np.abs(instants - read_s))) if piece is pieces[-1] else 0
            answer_um, state = straight_response(self.behind, part_um, instants, read, state)
        return answer_um[: played.voltage_v.size]
