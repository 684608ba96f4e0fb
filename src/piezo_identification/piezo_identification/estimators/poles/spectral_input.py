# SPDX-License-Identifier: BSD-3-Clause
"""Responses of single poles to a held input, at lines of its spectrum.

A response of a million samples needs a recursion over all of them; its spectrum needs only a
product at each selected line. Free oscillations at the beginning and end of a stretch add a
transient to each pole, of the same size at all lines (Pintelon and Schoukens, "System
Identification", 2012, 2.6), so that the relation is exact without a window.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.estimators.poles.pole_responses import PoleResponses, step_response

DELAYED = 3
"""Number of sample periods of delay for which the ends of a stretch are free."""

EXCITED, MOVED = 1e-3, 0.1
"""Strength of a line, relative to the strongest of the input, and its speed, relative to the
fastest, from which it shows the response. The strength of rare steps falls with frequency, their
speed does not."""


@dataclass(frozen=True, eq=False)
class SpectralLines:
    """Spectral lines of stretches of a record."""

    stretches: tuple[slice, ...]
    """Sample ranges of the stretches."""
    lines: tuple[NDArray[np.intp], ...]
    """Indices of the lines of each stretch."""

    @classmethod
    def excited_by(cls, samples: FloatArray, stretches: tuple[slice, ...],
                   most: int, slowest: float = 0.0) -> "SpectralLines":
        """Choose lines that an input excites, dense at low frequencies and spread over all.

        The input is (N,), and `most` the approximate number of lines in all stretches together. In
        a sample, each line advances at least by the phase `slowest` (rad).
        """
        chosen = []
        for stretch in stretches:
            strength = np.abs(_spectrum(samples[stretch] - samples[stretch].mean()))
            strength[: max(1, int(slowest * (stretch.stop - stretch.start) / (2.0 * np.pi)))] = 0.0
            speed = strength * np.arange(strength.size)
            excited = np.flatnonzero(
                (strength > EXCITED * strength.max()) | (speed > MOVED * speed.max()))
            share = most // len(stretches)
            if excited.size > share:
                ranks = np.concatenate([
                    np.linspace(0, excited.size - 1, share // 2),
                    np.searchsorted(excited, np.geomspace(excited[0], excited[-1], share // 2))])
                excited = excited[np.unique(ranks.astype(int))]
            chosen.append(excited)
        return cls(stretches, tuple(chosen))

    def of(self, signal: FloatArray) -> ComplexArray:
        """Return a signal of shape (N,) at the lines; white noise has twice its variance there."""
        return np.concatenate([
            _spectrum(signal[stretch])[lines]
            for stretch, lines in zip(self.stretches, self.lines, strict=True)])

    def phases(self) -> FloatArray:
        """Return the phase by which each line advances in a sample, in rad."""
        return np.concatenate([
            2.0 * np.pi * lines / (stretch.stop - stretch.start)
            for stretch, lines in zip(self.stretches, self.lines, strict=True)])


def _spectrum(signal: FloatArray) -> ComplexArray:
    return np.asarray(np.sqrt(2.0 / signal.size) * np.fft.rfft(signal))


def real_rows(values: ComplexArray) -> FloatArray:
    """Return real parts, (K, ...), followed by imaginary parts, together (2 K, ...)."""
    return np.concatenate([values.real, values.imag])


@dataclass(frozen=True, eq=False)
class SpectralInput:
    """A held input, as in `pole_responses.HeldInput`, seen at spectral lines.

    The rows of its responses are the real parts of all lines, then the imaginary parts. Responses
    of conjugate poles are conjugate, as in time, so that pairs of poles give real rows.
    """

    samples: FloatArray
    """Shape (N,)."""
    sample_period_s: float

    phases: FloatArray
    """Phase advance per sample at the lines, in rad, (K,)."""
    lines: ComplexArray
    """Spectrum of the input at the lines, (K,)."""
    counts: tuple[int, ...]
    """Number of lines of each stretch."""
    is_periodic: bool = False
    """True if the only stretch is a period of a periodic input, which has no ends."""

    def transients(self, poles: ComplexArray) -> FloatArray:
        """Return possible transients of each stretch: of all poles, of a level, and of delays.

        Of the poles (rad/s), (n,), one of each conjugate pair represents both. The result is (2 K,
        S (n + 1 + DELAYED)), and for a periodic input (2 K, 0).
        """
        if self.is_periodic:
            return np.empty((2 * self.phases.size, 0))
        own = poles[poles.imag >= 0.0]
        turn = np.exp(1j * self.phases)[:, None]
        decay = np.append(np.exp(own * self.sample_period_s), 1.0)
        scale = np.abs(1.0 - np.append(decay[:-1], 0.0))
        at, mirrored = (scale / (1.0 - decay / each) for each in (turn, turn.conj()))
        both = np.concatenate([0.5 * (at + mirrored), -0.5j * (at - mirrored)])
        late = turn ** -np.arange(DELAYED)
        columns = np.column_stack([
            both.real, both.imag[:, np.append(own.imag > 0.0, False)],
            np.concatenate([late.real, late.imag])])
        if len(self.counts) == 1:
            return columns
        number = np.tile(np.repeat(np.arange(len(self.counts)), self.counts), 2)
        return np.column_stack([
            np.where((number == each)[:, None], columns, 0.0) for each in range(len(self.counts))])

    def responses(
        self, poles: ComplexArray, delay: float, rows: NDArray[np.intp] | None = None,
    ) -> PoleResponses:
        """Return the response of every pole to the input; see `HeldInput.responses`.

        The rows are indices of the 2 K rows to compute; by default all.
        """
        at, mirrored = (self._at_lines(poles, delay, sign) for sign in (1.0, -1.0))
        values = []
        for one, other in zip(at, mirrored, strict=True):
            one, other = one * self.lines[:, None], other * self.lines.conj()[:, None]
            both = np.concatenate([0.5 * (one + other), -0.5j * (one - other)])
            values.append(np.asfortranarray(both if rows is None else both[rows]))
        return PoleResponses(*values)

    def _at_lines(self, poles: ComplexArray, delay: float,
                  sign: float) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Return the responses at the lines or their mirror images, (K, n), and derivatives."""
        scaled, period_s = poles * self.sample_period_s, self.sample_period_s
        ahead = int(np.floor(-delay))
        part = -delay - ahead
        turn = np.exp(1j * sign * self.phases)[:, None]
        decay, gain, gain_slope = step_response(scaled)
        late, late_gain, late_slope = step_response(scaled, part)
        state = gain / (turn - decay)
        slope = (gain_slope + state * decay) / (turn - decay)
        shift = turn**ahead
        value = shift * (late * state + late_gain)
        by_pole = shift * (late * (slope + part * state) + late_slope)
        return (value * period_s, by_pole * period_s**2, -(scaled * value + shift) * period_s)
