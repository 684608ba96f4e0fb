# SPDX-License-Identifier: BSD-3-Clause
"""Responses of single poles to a held input, at lines of its spectrum.

A response of a million samples costs a recursion over all of them, its spectrum a product at the
lines that are looked at. What rings at the beginning of a stretch and at its end adds a transient
to each pole, of one size at all lines (Pintelon and Schoukens, "System Identification", 2012, 2.6):
so the relation is exact without a window.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.estimators.poles.pole_responses import PoleResponses

DELAYED = 3
"""Sample periods of delay of which the ends of a stretch are free."""

EXCITED = 1e-3
"""Part of the strongest line of an input from which a line shows the response."""


@dataclass(frozen=True, eq=False)
class SpectralLines:
    """Lines of stretches of a record: where they are, and how a signal is seen there.

    Parameters
    ----------
    stretches : tuple of slice
        Of the samples.
    lines : tuple of ndarray of int
        Of each stretch.
    """

    stretches: tuple[slice, ...]
    lines: tuple[NDArray[np.intp], ...]

    @classmethod
    def excited_by(cls, samples: FloatArray, stretches: tuple[slice, ...],
                   most: int) -> "SpectralLines":
        """Choose lines at which an input excites, dense at low frequencies and spread over all.

        Parameters
        ----------
        samples : ndarray, shape (N,)
        most : int
            Lines of all stretches together, about.
        """
        chosen = []
        for stretch in stretches:
            strength = np.abs(_spectrum(samples[stretch] - samples[stretch].mean()))
            strength[0] = 0.0
            excited = np.flatnonzero(strength > EXCITED * strength.max())
            share = most // len(stretches)
            if excited.size > share:
                ranks = np.concatenate([
                    np.linspace(0, excited.size - 1, share // 2),
                    np.searchsorted(excited, np.geomspace(excited[0], excited[-1], share // 2))])
                excited = excited[np.unique(ranks.astype(int))]
            chosen.append(excited)
        return cls(stretches, tuple(chosen))

    def of(self, signal: FloatArray) -> ComplexArray:
        """Return a signal of shape (N,) at the lines, of white noise with its variance twice."""
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
    """Return real and then imaginary parts as rows, of shape (K,) the shape (2 K,)."""
    return np.concatenate([values.real, values.imag])


@dataclass(frozen=True, eq=False)
class SpectralInput:
    """An input whose samples are held, as a `pole_responses.HeldInput`, seen at lines.

    The rows of its responses are the real parts of all lines, then the imaginary parts. Those to
    conjugate poles are conjugate, as in time, so that pairs of poles give real rows.

    Parameters
    ----------
    samples : ndarray, shape (N,)
    phases : ndarray, shape (K,)
        Of the lines, in rad a sample.
    lines : ndarray of complex, shape (K,)
        The input at them.
    counts : tuple of int
        Lines of each stretch.
    is_periodic : bool
        The one stretch is a period of what has gone on for ever: it has no ends.
    """

    samples: FloatArray
    sample_period_s: float
    phases: FloatArray
    lines: ComplexArray
    counts: tuple[int, ...]
    is_periodic: bool = False

    def transients(self, poles: ComplexArray) -> FloatArray:
        """Return what may begin and end in each stretch: of all poles, of a level, and of delays.

        Parameters
        ----------
        poles : ndarray of complex, shape (n,)
            In rad/s; one of each conjugate pair counts for both.

        Returns
        -------
        ndarray, shape (2 K, S (n + 1 + DELAYED))
            Of a period (2 K, 0).
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
        """Respond to the input by every pole.

        Parameters
        ----------
        poles : ndarray of complex, shape (n,)
            In rad/s, stable.
        delay : float
            In sample periods, as for a `pole_responses.HeldInput`.
        rows : ndarray of int, optional
            Of the 2 K rows those that are wanted; by default all.
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
        decay, late = np.exp(scaled), np.exp(scaled * part)
        gain, late_gain = (decay - 1.0) / scaled, (late - 1.0) / scaled
        state = gain / (turn - decay)
        slope = ((decay - gain) / scaled + state * decay) / (turn - decay)
        late_slope = (part * late - late_gain) / scaled
        shift = turn**ahead
        value = shift * (late * state + late_gain)
        by_pole = shift * (late * (slope + part * state) + late_slope)
        return (value * period_s, by_pole * period_s**2, -(scaled * value + shift) * period_s)
