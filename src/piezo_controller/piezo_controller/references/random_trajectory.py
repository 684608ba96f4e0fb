# SPDX-License-Identifier: BSD-3-Clause
"""Random displacements within a frequency band, of unlimited duration."""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_controller.references.kind import (
    LOWEST_FREQUENCY_HZ,
    InvalidReference,
    Reference,
    Watch,
)
from piezo_controller.references.smooth_rise import smooth_rise
from piezo_controller.references.trajectory import Trajectory

LINES = 512
"""Number of sines of a block, equally spaced in the band; a block is one period of the spacing."""
FADE = 1 / 8
"""Part of a block in which the previous one fades out."""
# The fade widens each line, so none lies within this part of the band at its edges.
EDGE = 0.05
ROW_SAMPLES = 64
# With this number of points per sine the sampled envelope misses its peak by 2 % at most.
ENVELOPE_POINTS = 8
SURVEYED_BLOCKS, SURVEYED_PIECES, SURVEYED_SAMPLES = 8, 1000, 100
# Seeds must not be negative: this is added to the numbers of blocks before the beginning.
FIRST_SEQUENCE = 2**40


class RandomTrajectory(Trajectory):
    """Noise with a flat spectrum from one frequency to another, never beyond its amplitude.

    The amplitude is the whole range, peak to peak (um). Blocks of sines of random amplitude and
    phase are faded into one another. Each block is drawn from the seed and its number, and scaled
    by its envelope, so any piece can be computed alone.
    """

    def __init__(self, low_hz: float, high_hz: float, amplitude_um: float, centre_um: float = 0.0,
                 seed: int = 0, sample_rate_hz: float = 40000.0) -> None:
        width_hz = high_hz - low_hz
        self._lines = low_hz + width_hz * np.linspace(EDGE, 1 - EDGE, LINES)
        self._lines /= sample_rate_hz  # in cycles per sample
        self._samples = max(round(1 / (self._lines[1] - self._lines[0])), 2)
        self._fade = max(math.ceil(FADE * self._samples), 1)
        self._amplitude_um, self._centre_um, self._seed = amplitude_um, centre_um, seed
        self._row = _turns(self._lines, np.arange(ROW_SAMPLES))
        # Two threads need neighbouring blocks.
        self._coefficients = lru_cache(maxsize=8)(self._draw)

    def sample(self, first: int, count: int) -> FloatArray:
        """See `Trajectory.sample`."""
        values, hop = np.zeros(count), self._samples - self._fade
        for number in range((first - self._fade) // hop, (first + count - 1) // hop + 1):
            begin = number * hop
            low, high = max(first, begin), min(first + count, begin + self._samples)
            if low < high:
                at = np.arange(low - begin, high - begin)
                weight = smooth_rise(at / self._fade) - smooth_rise((at - hop) / self._fade)
                values[low - first:high - first] += weight * self._block(number, at[0], at.size)
        return self._centre_um + values

    def survey(self, samples: int) -> FloatArray:
        """See `Trajectory.survey`: pieces of the first blocks."""
        if samples <= SURVEYED_PIECES * SURVEYED_SAMPLES:
            return self.sample(0, samples)
        end = min(samples, SURVEYED_BLOCKS * self._samples) - SURVEYED_SAMPLES
        begins = np.linspace(0, end, SURVEYED_PIECES).astype(np.int64)
        return np.concatenate([self.sample(int(begin), SURVEYED_SAMPLES) for begin in begins])

    def _block(self, number: int, first: int, count: int) -> FloatArray:
        """Return samples of a block (um), computed row by row by the addition theorem."""
        rows = np.arange(first // ROW_SAMPLES, (first + count - 1) // ROW_SAMPLES + 1)
        columns = self._coefficients(number) * _turns(self._lines, rows * ROW_SAMPLES)
        table = columns.real @ self._row.real.T - columns.imag @ self._row.imag.T
        begin = first - rows[0] * ROW_SAMPLES
        return table.ravel()[begin:begin + count]

    def _draw(self, number: int) -> ComplexArray:
        """Draw the complex amplitudes of the lines of a block (um), shape (LINES,)."""
        generator = np.random.default_rng([self._seed, FIRST_SEQUENCE + number])
        drawn = generator.standard_normal(LINES) + 1j * generator.standard_normal(LINES)
        envelope = np.abs(np.fft.fft(drawn, ENVELOPE_POINTS * LINES)).max()
        bound = envelope / math.cos(math.pi / (2 * ENVELOPE_POINTS))
        return self._amplitude_um / 2 / bound * drawn


def _turns(lines: FloatArray, samples: NDArray[np.int64]) -> ComplexArray:
    """Return the unit vectors of each line at each sample, shape (samples, lines)."""
    return np.exp(2j * np.pi * (np.outer(samples, lines) % 1.0))


class RandomKind:
    """Random references, which have no period and are streamed."""

    def is_periodic(self, reference: Reference, sample_rate_hz: float) -> bool:
        """Return False: there is no period."""
        return False

    def period_um(self, reference: Reference, sample_rate_hz: float) -> FloatArray:
        """Raise `InvalidReference`, as there is no period."""
        raise InvalidReference("a random reference that is not repeated has no period: "
                               "use a mode that streams it")

    def trajectory(self, reference: Reference, sample_rate_hz: float, watch: Watch) -> Trajectory:
        """Check the band, and return noise that is drawn from the seed."""
        edges_hz, amplitude_um = tuple(reference.frequency_hz), tuple(reference.amplitude_um)
        if len(edges_hz) not in (1, 2) or len(amplitude_um) != 1:
            raise InvalidReference("a random reference has one or two frequencies, the edges of "
                                   f"its band, and one amplitude, not {len(edges_hz)} and "
                                   f"{len(amplitude_um)}: give those")
        low_hz, high_hz = (0.0, *edges_hz)[-2:]
        if not 0 <= low_hz < high_hz < sample_rate_hz / 2:
            raise InvalidReference(f"the band from {low_hz:g} to {high_hz:g} Hz is not between 0 "
                                   f"and half the sample rate of {sample_rate_hz:g} Hz: choose "
                                   "one that is")
        if high_hz - low_hz < LOWEST_FREQUENCY_HZ:
            raise InvalidReference(f"the band from {low_hz:g} to {high_hz:g} Hz is narrower than "
                                   f"{LOWEST_FREQUENCY_HZ:g} Hz: use a harmonic")
        if not 0 < amplitude_um[0] < math.inf:
            raise InvalidReference(f"amplitude_um {amplitude_um[0]:g} is not a positive number: "
                                   "give it from peak to peak")
        if reference.seed < 0:
            raise InvalidReference(f"seed {reference.seed} is negative: give 0 or more")
        return RandomTrajectory(low_hz, high_hz, amplitude_um[0], reference.centre_um,
                                reference.seed, sample_rate_hz)
