# SPDX-License-Identifier: BSD-3-Clause
"""Rational responses with a delay as parameter vectors, with modes in series or in parallel."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigvals

from piezo_common.arrays import BoolArray, ComplexArray, FloatArray
from piezo_identification.fitting.measured_response import HIGHEST_MODE, MOST_LOSS_RAD

BAND = (0.1, HIGHEST_MODE)
"""Range of poles and zeros, relative to the lowest and the highest measured rate."""

DAMPINGS = (1.001e-5, 99.9)
"""Range of damping ratios of modes; a pair beyond 1 is two relaxations."""

LONGEST_DELAY = 1e4
"""Longest delay in radian periods (1 / rate) of the highest measured frequency."""

DELAY, LAG, LOSS = 0, 1, 2
"""Indices in a vector. Delay and lag are relative to the inverse of the highest measured rate; the
loss is the angle in rad by which hysteresis delays small sines of any frequency."""

Reduced = tuple["RationalForm", FloatArray, BoolArray]
"""A form with fewer parameters, its vector, and which of the parameters are free."""


@dataclass(frozen=True)
class RationalForm:
    """A delay, a lag, creep pairs, and modes, as the layout of a vector.

    The vector contains the delay, the lag and the loss; logarithms of the creep's poles and
    zeros; the gain; logarithms of the modes' frequencies and damping ratios. For modes in series,
    logarithms of the antiresonances' frequencies and damping ratios follow. For parallel modes, the
    gain is that of the instantaneous part, and the participations of the modes follow: of their
    positions, then of their scaled velocities.
    """

    creep_pairs: int
    modes: int

    antiresonances: int = 0
    """0 for parallel modes."""
    is_parallel: bool = True

    @property
    def creep_places(self) -> NDArray[np.intp]:
        """Indices of poles and zeros of the creep, shape (2, creep_pairs)."""
        return LOSS + 1 + np.arange(2 * self.creep_pairs).reshape(2, -1)

    @property
    def gain_place(self) -> int:
        """Index of the gain, or of the instantaneous part."""
        return LOSS + 1 + 2 * self.creep_pairs

    @property
    def mode_places(self) -> NDArray[np.intp]:
        """Indices of frequency and damping of modes; for parallel modes, of both parts too."""
        rows = 4 if self.is_parallel else 2
        return self.gain_place + 1 + np.arange(rows * self.modes).reshape(rows, -1)

    @property
    def zero_places(self) -> NDArray[np.intp]:
        """Indices of frequency and damping of antiresonances, shape (2, antiresonances)."""
        first = self.gain_place + 1 + 2 * self.modes
        return first + np.arange(2 * self.antiresonances).reshape(2, -1)

    @property
    def size(self) -> int:
        """Length of a vector."""
        return self.gain_place + 1 + self.mode_places.size + self.zero_places.size

    @property
    def linear_places(self) -> NDArray[np.intp]:
        """Indices of the elements in which the response is linear."""
        parts = self.mode_places[2:].ravel()
        return np.append(self.gain_place, parts).astype(np.intp)

    def bounds(self, rate: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds of the vector for increasing measured rates."""
        low, high = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        low[[DELAY, LAG]] = 0.0
        # Slower lags are creep.
        high[[DELAY, LAG]] = LONGEST_DELAY, np.sqrt(rate[-1] / rate[0])
        low[LOSS], high[LOSS] = 0.0, MOST_LOSS_RAD
        slow, fast = np.log([BAND[0] * rate[0], BAND[1] * rate[-1]])
        low[self.creep_places], high[self.creep_places] = slow, 0.5 * np.log(rate[0] * rate[-1])
        for places in (self.mode_places, self.zero_places):
            low[places[0]], high[places[0]] = slow, fast
            low[places[1]], high[places[1]] = np.log(DAMPINGS)
        return low, high

    def response(self, vector: FloatArray, rate: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Response at measured rates, shape (N,), and its derivatives, shape (N, P)."""
        s = np.asarray(1j * rate[:, None], dtype=complex)
        scaled = s / rate[-1]
        poles, zeros = np.exp(vector[self.creep_places])
        late = np.exp(-scaled * vector[DELAY] - 1j * vector[LOSS]) / (1.0 + scaled * vector[LAG])
        before = late * np.prod((s + zeros) / (s + poles), axis=1, keepdims=True)
        core, slopes = (self._parallel if self.is_parallel else self._in_series)(vector, s)
        whole = before * core
        derivatives = np.hstack([
            -scaled * whole, -scaled / (1.0 + scaled * vector[LAG]) * whole, -1j * whole,
            -poles / (s + poles) * whole, zeros / (s + zeros) * whole, before * slopes])
        return whole[:, 0], derivatives

    def _in_series(self, vector: FloatArray, s: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        modes, by_mode = _quadratics(vector, self.mode_places, s)
        zeros, by_zero = _quadratics(vector, self.zero_places, s)
        shape = np.prod(zeros, axis=1, keepdims=True) / np.prod(modes, axis=1, keepdims=True)
        core = vector[self.gain_place] * shape
        return core, np.hstack([
            shape, *(-core * slope / modes for slope in by_mode),
            *(core * slope / zeros for slope in by_zero)])

    def _parallel(self, vector: FloatArray, s: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        quadratics, slopes = _quadratics(vector, self.mode_places, s)
        position, velocity = vector[self.mode_places[2:]]
        ratio = s / np.exp(vector[self.mode_places[0]])
        parts = (position + velocity * ratio) / quadratics
        core = vector[self.gain_place] + parts.sum(axis=1, keepdims=True)
        by_frequency, by_damping = (-parts * slope / quadratics for slope in slopes)
        return core, np.hstack([
            np.ones_like(s), by_frequency - velocity * ratio / quadratics, by_damping,
            1.0 / quadratics, ratio / quadratics])

    def with_mode(self, vector: FloatArray, free: BoolArray, mode: FloatArray) -> Reduced:
        """Add a parallel mode: logarithms of frequency and damping, then its participations."""
        places = self.mode_places
        vector = np.concatenate([vector[: self.gain_place + 1],
                                 np.column_stack([vector[places], mode]).ravel()])
        free = np.concatenate([free[: self.gain_place + 1],
                               np.column_stack([free[places], np.ones(4, dtype=bool)]).ravel()])
        return replace(self, modes=self.modes + 1), vector, free

    def with_creep(self, vector: FloatArray, free: BoolArray, pole: float, zero: float) -> Reduced:
        """Add a creep pair, given as logarithms."""
        at = self.creep_places[:, -1] + 1 if self.creep_pairs else [LOSS + 1] * 2
        return (replace(self, creep_pairs=self.creep_pairs + 1),
                np.insert(vector, at, [pole, zero]), np.insert(free, at, True))

    def reduced(self, vector: FloatArray, free: BoolArray) -> Iterator[Reduced]:
        """Yield the form without the delay, the lag, the loss, and each other component."""
        droppable = [DELAY, LAG, LOSS]
        if self.is_parallel:
            droppable += [self.gain_place] * (self.modes > 0) + self.mode_places[3].tolist()
        for place in droppable:
            if free[place]:
                without, kept = vector.copy(), free.copy()
                without[place], kept[place] = 0.0, False
                yield self, without, kept
        for places in self.creep_places.T:
            yield self._without(vector, free, places, creep_pairs=self.creep_pairs - 1)
        for places in self.zero_places.T:
            yield self._without(vector, free, places, antiresonances=self.antiresonances - 1)
        if self.modes > 1 or (self.modes and (free[self.gain_place] or not self.is_parallel)):
            yield from self._without_modes(vector, free)

    def _without_modes(self, vector: FloatArray, free: BoolArray) -> Iterator[Reduced]:
        for places in self.mode_places.T:
            if self.antiresonances < self.modes:
                yield self._without(vector, free, places, modes=self.modes - 1)
            if self.antiresonances:
                nearest = np.argmin(np.abs(vector[self.zero_places[0]] - vector[places[0]]))
                both = np.concatenate([places, self.zero_places[:, nearest]])
                yield self._without(vector, free, both, modes=self.modes - 1,
                                    antiresonances=self.antiresonances - 1)

    def _without(self, vector: FloatArray, free: BoolArray, places: NDArray[np.intp],
                 **counts: Any) -> Reduced:
        return replace(self, **counts), np.delete(vector, places), np.delete(free, places)

    def zeros_between(self, vector: FloatArray, rate: FloatArray) -> FloatArray:
        """Return zeros of parallel modes, mirrored into the left half plane, as antiresonances.

        These are logarithms of frequencies and of positive damping ratios, (2, M), at most one per
        mode.
        """
        w, damping = np.exp(vector[self.mode_places[:2]]) / [[rate[-1]], [1.0]]
        system = np.zeros((2 * self.modes + 1, 2 * self.modes + 1))
        for i, (frequency, ratio) in enumerate(zip(w, damping, strict=True)):
            system[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [
                [0.0, frequency], [-frequency, -2.0 * ratio * frequency]]
        system[1:-1:2, -1] = w
        system[-1, :-1] = vector[self.mode_places[2:]].T.ravel()
        system[-1, -1] = vector[self.gain_place]
        zeros = _finite_eigenvalues(system) * rate[-1]
        zeros = zeros[np.abs(zeros) < BAND[1] * rate[-1]]
        real = np.sort(-zeros[(zeros.imag == 0.0) & (zeros.real < 0.0)].real)
        pairs = real[real.size % 2 :].reshape(-1, 2)
        zeros = zeros[zeros.imag > 0.0]
        frequency = np.append(np.abs(zeros), np.sqrt(pairs[:, 0] * pairs[:, 1]))
        damping = np.append(np.abs(zeros.real), pairs.mean(axis=1)) / frequency
        kept = np.argsort(damping)[: self.modes]
        return np.log([frequency[kept], np.clip(damping[kept], *DAMPINGS)])


def _finite_eigenvalues(system: FloatArray) -> ComplexArray:
    """Zeros of a system, from the pencil of its matrices, states first."""
    states = np.diag(np.append(np.ones(system.shape[0] - 1), 0.0))
    values = eigvals(system, states)
    return values[np.isfinite(values)]


def _quadratics(
    vector: FloatArray, places: NDArray[np.intp], s: ComplexArray,
) -> tuple[ComplexArray, tuple[ComplexArray, ComplexArray]]:
    """(s / w)^2 + 2 d s / w + 1, and its derivatives by the logarithms of w and of d."""
    frequency, damping = np.exp(vector[places[:2]])
    ratio = s / frequency
    by_damping = 2.0 * damping * ratio
    return ratio**2 + by_damping + 1.0, (-2.0 * ratio**2 - by_damping, by_damping)
