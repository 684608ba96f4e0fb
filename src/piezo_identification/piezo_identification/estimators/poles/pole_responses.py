# SPDX-License-Identifier: BSD-3-Clause
"""Responses of single poles to a held input, at any fraction of a sample period."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from piezo_common.arrays import ComplexArray, FloatArray


@dataclass(frozen=True, eq=False)
class PoleResponses:
    """Responses of 1 / (s - p) to an input, and their derivatives."""

    value: ComplexArray
    """One column for each pole, (N, n)."""
    by_pole: ComplexArray
    """Derivatives by the pole, (N, n)."""
    by_delay: ComplexArray
    """Derivatives by the delay in sample periods, (N, n)."""


@dataclass(frozen=True, eq=False)
class HeldInput:
    """An input whose samples are held for a sample period each."""

    samples: FloatArray
    """Shape (N,)."""
    sample_period_s: float

    is_periodic: bool
    """True if the samples are one period of a periodic input. Otherwise, the first sample was held
    for all time before, and the last one is held for all time after."""
    begins: tuple[int, ...] = (0,)
    """Samples at which independent inputs begin. Unused if periodic."""
    early: FloatArray | None = None
    """Fraction of a sample period by which the input changes to each sample before its time, (N,).
    By default 0; 0 where an input begins. Unused if periodic."""

    def responses(
        self, poles: ComplexArray, delay: float, rows: NDArray[np.intp] | None = None,
    ) -> PoleResponses:
        """Return the response of every stable pole (rad/s), (n,), to the input.

        The delay is in sample periods: output sample n is the response at n minus the delay. If it
        is negative, the output is read after the input changes. `rows`, (K,), are the ascending
        indices of the output samples to compute; by default all.
        """
        scaled = poles * self.sample_period_s
        ahead = int(np.floor(-delay))
        part = -delay - ahead
        rows = self._places(ahead, rows)
        state, slope = self._states(scaled, rows)
        decay, gain, gain_slope = step_response(scaled, part)
        value, by_pole, by_delay = _read(
            state, slope, self.samples[rows], scaled, part, decay, gain, gain_slope,
            self.sample_period_s)
        if self.early is not None and part > 0.0:
            self._add_edges_before(part, rows, scaled, value, by_pole, by_delay)
        return PoleResponses(value.T, by_pole.T, by_delay.T)

    def _add_edges_before(
        self, part: float, rows: NDArray[np.intp], scaled: ComplexArray, value: ComplexArray,
        by_pole: ComplexArray, by_delay: ComplexArray,
    ) -> None:
        """Add the responses to early steps that precede the instant of reading in its period."""
        assert self.early is not None
        following = np.minimum(rows + 1, self.samples.size - 1)
        since = self.early[following] + part - 1.0
        read = np.flatnonzero((self.early[following] != 0.0) & (since > 0.0))
        change = (self.samples[following] - self.samples[rows])[read]
        _, gain, gain_slope = step_response(scaled[:, None], since[read])
        period_s = self.sample_period_s
        value[:, read] += change * gain * period_s
        by_pole[:, read] += change * gain_slope * period_s**2
        by_delay[:, read] -= change * (scaled[:, None] * gain + 1.0) * period_s

    def _states(
        self, scaled: ComplexArray, rows: NDArray[np.intp],
    ) -> tuple[ComplexArray, ComplexArray]:
        """States at some samples, shape (n, K), and their derivatives by the scaled poles."""
        decay, gain, gain_slope = step_response(scaled)
        if self.is_periodic:
            every = np.arange(self.samples.size)
            nothing = np.zeros_like(decay)
            _, _, state, slope = _run(
                decay, gain, gain_slope, self.samples, nothing, nothing, every, *_NO_EDGES)
            rest = 1.0 - decay ** self.samples.size
            start = state / rest
            start_slope = (slope + self.samples.size * (1.0 - rest) * start) / rest
            states, slopes, _, _ = _run(
                decay, gain, gain_slope, self.samples, start, start_slope, every, *_NO_EDGES)
            return states.take(rows, axis=1), slopes.take(rows, axis=1)
        runs = []
        for begin, end in zip(self.begins, [*self.begins[1:], self.samples.size], strict=True):
            wanted = rows[slice(*np.searchsorted(rows, [begin, end]))] - begin
            part = self.samples[begin:end]
            runs.append(_run(decay, gain, gain_slope, part, -part[0] / scaled,
                             part[0] / scaled**2, wanted, *self._edges(begin, end, scaled)))
        if len(runs) == 1:
            return runs[0][0], runs[0][1]
        return (np.concatenate([run[0] for run in runs], axis=1),
                np.concatenate([run[1] for run in runs], axis=1))

    def _edges(
        self, begin: int, end: int, scaled: ComplexArray,
    ) -> tuple[NDArray[np.intp], ComplexArray, ComplexArray]:
        """Return the indices of early samples, and what they add to each state and slope."""
        if self.early is None:
            return _NO_EDGES
        at = np.flatnonzero(self.early[begin:end])
        change = self.samples[begin + at] - self.samples[begin + at - 1]
        _, gain, gain_slope = step_response(scaled[:, None], self.early[begin + at])
        return at, change * gain, change * gain_slope

    def _places(self, ahead: int, rows: NDArray[np.intp] | None) -> NDArray[np.intp]:
        """Return sample indices shifted ahead, clipped to the input that each belongs to."""
        size = self.samples.size
        wanted: NDArray[np.intp] = np.arange(size) if rows is None else rows
        if self.is_periodic:
            return (wanted + ahead) % size
        first, last = np.array(self.begins), np.array([*self.begins[1:], size]) - 1
        number = np.searchsorted(first, wanted, side="right") - 1
        return np.clip(wanted + ahead, first[number], last[number])


_NO_EDGES = (np.empty(0, dtype=np.intp), np.empty((0, 0), dtype=complex),
             np.empty((0, 0), dtype=complex))


def step_response(
    scaled: ComplexArray, time: FloatArray | float = 1.0,
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Decay in a time in sample periods, step response after it, and its slope by the poles."""
    decay = np.exp(scaled * time)
    gain = (decay - 1.0) / scaled
    return decay, gain, (time * decay - gain) / scaled


@njit(cache=True)
def _run(
    decay: ComplexArray, gain: ComplexArray, gain_slope: ComplexArray, samples: FloatArray,
    start: ComplexArray, start_slope: ComplexArray, rows: NDArray[np.intp],
    edges: NDArray[np.intp], of_edge: ComplexArray, slope_of_edge: ComplexArray,
) -> tuple[ComplexArray, ComplexArray, ComplexArray, ComplexArray]:
    """States and their derivatives at some samples, and those after the last sample."""
    states = np.empty((decay.size, rows.size), dtype=np.complex128)
    slopes = np.empty((decay.size, rows.size), dtype=np.complex128)
    last, last_slope = start.copy(), start_slope.copy()
    for i in range(decay.size):
        if i > 0 and (decay[i] == np.conj(decay[i - 1]) and gain[i] == np.conj(gain[i - 1])
                      and start[i] == np.conj(start[i - 1])):
            states[i], slopes[i] = np.conj(states[i - 1]), np.conj(slopes[i - 1])
            last[i], last_slope[i] = np.conj(last[i - 1]), np.conj(last_slope[i - 1])
            continue
        state, slope = start[i], start_slope[i]
        n, edge = 0, 0
        # Only the requested rows are stored: storing all takes longer than the recursion.
        for k in range(rows.size + 1):
            until = rows[k] if k < rows.size else samples.size
            while n < until:
                stop = min(until, edges[edge]) if edge < edges.size else until
                for m in range(n, stop):
                    slope = decay[i] * (slope + state) + gain_slope[i] * samples[m]
                    state = decay[i] * state + gain[i] * samples[m]
                n = stop
                if edge < edges.size and n == edges[edge]:
                    state += of_edge[i, edge]
                    slope += slope_of_edge[i, edge]
                    edge += 1
            if k < rows.size:
                states[i, k], slopes[i, k] = state, slope
        last[i], last_slope[i] = state, slope
    return states, slopes, last, last_slope


@njit(cache=True)
def _read(
    states: ComplexArray, slopes: ComplexArray, held: FloatArray, scaled: ComplexArray,
    part: float, decay: ComplexArray, gain: ComplexArray, gain_slope: ComplexArray,
    period_s: float,
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Responses a fraction of a sample period after some samples, and their derivatives."""
    # One pass, because whole-array operations would take most of the time of a fit.
    values = np.empty(states.shape, dtype=np.complex128)
    by_pole = np.empty(states.shape, dtype=np.complex128)
    by_delay = np.empty(states.shape, dtype=np.complex128)
    for i in range(scaled.size):
        for k in range(held.size):
            value = decay[i] * states[i, k] + gain[i] * held[k]
            slope = decay[i] * (slopes[i, k] + part * states[i, k]) + gain_slope[i] * held[k]
            # Time is counted in sample periods, and 1 / (s - p) has the unit of a time.
            values[i, k] = value * period_s
            by_pole[i, k] = slope * period_s**2
            by_delay[i, k] = -(scaled[i] * value + held[k]) * period_s
    return values, by_pole, by_delay
