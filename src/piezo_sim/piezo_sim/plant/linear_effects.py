# SPDX-License-Identifier: BSD-3-Clause
"""Linear effects in series, advanced by exact zero-order-hold discretisation of the whole series.

The input is constant within a sample, so x[n+1] = A x[n] + B u[n] with the matrix exponential is
exact; y[n] = C x[n] is the output at the start of the sample.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numba import njit
from scipy.linalg import expm

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import (
    POSITIVE,
    Bounded,
    Effect,
    PlantConfigError,
    parameter,
    require,
)


class StateSpace(NamedTuple):
    """Matrices of dx/dt = a x + b u, y = c x + d u.

    Their shapes are (n, n), (n,), (n,) and scalar; rates are in rad/s.
    """

    a: FloatArray
    b: FloatArray
    c: FloatArray
    d: float


@runtime_checkable
class LinearEffect(Effect, Protocol):
    """A linear and time-invariant effect; neighbouring ones are discretised together."""

    def state_space(self) -> StateSpace:
        """Return the dynamics of the effect."""


@runtime_checkable
class ParallelEffect(LinearEffect, Protocol):
    """A linear effect in parallel with some before it."""

    @property
    def beside(self) -> int:
        """Return the number of linear effects before it with which it is in parallel."""

    def join(self, others: StateSpace) -> StateSpace:
        """Return the parallel connection of the effect and the series of those others."""


@runtime_checkable
class ChangingEffect(LinearEffect, Protocol):
    """A linear effect that changes at a given time."""

    @property
    def begin_s(self) -> float:
        """Return the time of the change (s of stage time)."""

    def changed(self) -> StateSpace:
        """Return the dynamics after the change, with the same states."""


class _Changed:
    """A changing effect after its change."""

    def __init__(self, effect: ChangingEffect) -> None:
        self.name, self.state_space = effect.name, effect.changed


def series(first: StateSpace, second: StateSpace) -> StateSpace:
    """Return the system `first` followed by the system `second`."""
    n, m = first.b.size, second.b.size
    a = np.zeros((n + m, n + m))
    a[:n, :n] = first.a
    a[n:, :n] = np.outer(second.b, first.c)
    a[n:, n:] = second.a
    return StateSpace(
        a,
        np.concatenate([first.b, second.b * first.d]),
        np.concatenate([second.d * first.c, second.c]),
        second.d * first.d,
    )


def chain(effects: Sequence[LinearEffect]) -> StateSpace:
    """Return the connection of linear effects in the order of the signal.

    Most are in series; a `ParallelEffect` is in parallel with the series of those before it.
    PlantConfigError is raised if there are fewer linear effects directly before an effect than it
    is parallel to.
    """
    systems: list[StateSpace] = []
    for effect in effects:
        if not isinstance(effect, ParallelEffect):
            systems.append(effect.state_space())
            continue
        beside = effect.beside
        if beside > len(systems):
            raise PlantConfigError(
                f"{effect.name}: it is parallel to {beside} linear effects, but only "
                f"{len(systems)} lie directly before it."
            )
        systems[-beside:] = [effect.join(reduce(series, systems[-beside:]))]
    return reduce(series, systems)


def zero_order_hold(system: StateSpace, sample_period_s: float) -> tuple[FloatArray, FloatArray]:
    """Return the exact discrete matrices A (n, n) and B (n,) for an input that is held."""
    n = system.b.size
    augmented = np.zeros((n + 1, n + 1))
    augmented[:n, :n] = system.a
    augmented[:n, n] = system.b
    exponential = expm(augmented * sample_period_s)
    return exponential[:n, :n], exponential[:n, n]


@njit(cache=True)
def _advance(samples: FloatArray, state: FloatArray, following: FloatArray, own: FloatArray,
             a_columns: FloatArray, b: FloatArray, c: FloatArray) -> None:
    order, alone = state.size, own.size
    for n in range(samples.size):
        level = samples[n]
        output = 0.0
        for i in range(order):
            output += c[i] * state[i]
            following[i] = b[i] * level
        for i in range(alone):
            following[i] += own[i] * state[i]
        behind = following[alone:]
        for j in range(order):
            value = state[j]
            for i in range(behind.size):
                behind[i] += a_columns[j, i] * value
        for i in range(order):
            state[i] = following[i]
        samples[n] = output


def _alone(a: FloatArray) -> int:
    """Return the number of first states that depend only on themselves, as parallel relaxations."""
    others = np.flatnonzero((a - np.diag(np.diagonal(a))).any(axis=1))
    return int(others[0]) if others.size else len(a)


class LinearRunner:
    """Linear effects in series with their common state.

    PlantConfigError is raised if the output follows the input without a lag, so that a measurement
    would depend on a voltage that has not acted yet.
    """

    def __init__(self, effects: Sequence[LinearEffect], sample_period_s: float) -> None:
        self._effects: list[Any] = list(effects)
        self._period_s = sample_period_s
        self._changes = sorted(
            (round(effect.begin_s / sample_period_s), index)
            for index, effect in enumerate(effects) if isinstance(effect, ChangingEffect))
        self._at = 0
        self._discretise()
        self._state = np.zeros(self._system.b.size)
        self._following = np.zeros(self._system.b.size)

    def _discretise(self) -> None:
        system = chain(self._effects)
        if system.d != 0.0:
            names = ", ".join(effect.name for effect in self._effects)
            raise PlantConfigError(
                f"{names}: the displacement would jump with the voltage; "
                "add an effect with a lag to the same series."
            )
        self._system = system
        a, self._b = zero_order_hold(system, self._period_s)
        alone = _alone(a)
        self._own = np.diagonal(a)[:alone].copy()
        self._columns_behind = np.ascontiguousarray(a[alone:].T)

    def rest(self, level: float) -> float:
        """Settle at the constant input `level`."""
        self._state[:] = np.linalg.solve(self._system.a, -self._system.b * level)
        return float(self._system.c @ self._state)

    def apply(self, samples: FloatArray) -> None:
        """Replace inputs by outputs at the start of each sample."""
        end = self._at + samples.size
        while self._changes and self._changes[0][0] < end:
            change, index = self._changes.pop(0)
            before, samples = np.split(samples, [max(change - self._at, 0)])
            self._advance(before)
            self._effects[index] = _Changed(self._effects[index])
            self._discretise()
        self._advance(samples)

    def _advance(self, samples: FloatArray) -> None:
        _advance(samples, self._state, self._following, self._own, self._columns_behind, self._b,
                 self._system.c)
        self._at += samples.size


@dataclass(frozen=True)
class Creep(Bounded):
    """Slow relaxations, prod (s + z) / (s + p): unit gain at high frequency (thesis eq. (4.4))."""

    name: ClassVar[str] = "creep"

    poles_rad_per_s: tuple[float, ...] = parameter("rad/s", POSITIVE)
    zeros_rad_per_s: tuple[float, ...] = parameter("rad/s", POSITIVE)

    def __post_init__(self) -> None:
        super().__post_init__()
        require(
            len(self.poles_rad_per_s) == len(self.zeros_rad_per_s) > 0,
            self,
            "poles_rad_per_s and zeros_rad_per_s must be lists of the same length.",
        )

    def state_space(self) -> StateSpace:
        """Return the series of one section for each pole."""
        return reduce(series, (
            StateSpace(np.array([[-pole]]), np.array([1.0]), np.array([zero - pole]), 1.0)
            for pole, zero in zip(self.poles_rad_per_s, self.zeros_rad_per_s, strict=True)))


@dataclass(frozen=True)
class ElectricLag(Bounded):
    """Resistance and capacitance of the actuator, 1 / (tau s + 1) (thesis eq. (4.3))."""

    name: ClassVar[str] = "electric_lag"

    time_constant_s: float = parameter("s", POSITIVE)

    def state_space(self) -> StateSpace:
        """Return the low-pass filter; its state is its output."""
        rate = 1.0 / self.time_constant_s
        return StateSpace(np.array([[-rate]]), np.array([rate]), np.array([1.0]), 0.0)


@dataclass(frozen=True)
class VibrationMode(Bounded):
    """One mechanical mode, w^2 / (s^2 + 2 zeta w s + w^2) (thesis eq. (4.3))."""

    name: ClassVar[str] = "vibration_mode"

    frequency_rad_per_s: float = parameter("rad/s", POSITIVE)
    damping_ratio: float = parameter("1", POSITIVE)

    def state_space(self) -> StateSpace:
        """Return the mode in position and velocity / w, which keeps the matrix balanced."""
        w = self.frequency_rad_per_s
        a = np.array([[0.0, w], [-w, -2.0 * self.damping_ratio * w]])
        return StateSpace(a, np.array([0.0, w]), np.array([1.0, 0.0]), 0.0)
