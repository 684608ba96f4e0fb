# SPDX-License-Identifier: BSD-3-Clause
"""Disturbance of one frequency, for example from mains, a pump or the building."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from numba import njit

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_models.effects.effect import LEAST, MOST, Evidence, Extent, parameter
from piezo_models.effects.effect_of_time import EffectOfTime

FEWEST_PERIODS = 10
"""Periods that a recording must contain; slower disturbances are drift."""
HARMONICS = 2

DRIVEN = 0.05
"""Fraction of the displacement's energy above which a line belongs to the waveform."""
LINE_BINS = 2

WANDERING = 3
"""Waves over a recording by which amplitudes, and so phases, of the tones may change."""

TURNED_ON = 64
"""Samples after which the angle is computed anew, to limit the rounding error."""


@njit(cache=True, nogil=True)
def _sum_of_tones(sizes: ComplexArray, turn: float, first: int, samples: int) -> FloatArray:
    """Return Re (c - i s) exp(i p)^k = c cos k p + s sin k p, summed over the harmonics k."""
    tones = np.empty(samples)
    step = np.exp(1j * turn)
    for begin in range(0, samples, TURNED_ON):
        number = np.exp(1j * turn * (first + begin))
        for n in range(begin, min(begin + TURNED_ON, samples)):
            # Horner's scheme in the rotating number.
            value = 0j
            for k in range(sizes.size - 1, -1, -1):
                value = (value + sizes[k]) * number
            tones[n] = value.real
            number *= step
    return tones


@dataclass(frozen=True)
class PeriodicDisturbance(EffectOfTime):
    """A tone added to the displacement, with its phase at the first sample.

    Its harmonics, from the second on, have independent amplitudes.
    """

    name: ClassVar[str] = "periodic_disturbance"
    several: ClassVar[bool] = True
    recurs: ClassVar[bool] = True
    experiment: ClassVar[str] = "rest, at the full sample clock"
    distortion: ClassVar[frozenset[str] | None] = frozenset()

    frequency_hz: float = parameter("Hz", "linear", LEAST, MOST)
    cosine_um: float = parameter("um")
    sine_um: float = parameter("um")
    harmonic_cosines_um: tuple[float, ...] = parameter("um", default=())
    harmonic_sines_um: tuple[float, ...] = parameter("um", default=())

    def _tones(self, samples: int, sample_period_s: float, first: int = 0) -> FloatArray:
        sample = np.arange(first, first + samples)
        phase = 2.0 * np.pi * self.frequency_hz * sample_period_s * sample
        multiples = range(1, 2 + len(self.harmonic_cosines_um))
        return np.column_stack([
            *(np.cos(multiple * phase) for multiple in multiples),
            *(np.sin(multiple * phase) for multiple in multiples),
        ])

    def behind(self, signal: FloatArray, sample_period_s: float, first: int) -> FloatArray:
        """Return a part of the signal behind the effect, as `EffectOfTime.behind` describes."""
        sizes = np.array([self.cosine_um, *self.harmonic_cosines_um]) - 1j * np.array(
            [self.sine_um, *self.harmonic_sines_um])
        turn = 2.0 * np.pi * self.frequency_hz * sample_period_s
        return signal + _sum_of_tones(sizes, turn, first, signal.size)

    def recurrence(self, time_s: FloatArray, duration_s: float) -> FloatArray:
        """Return tones of the same frequencies with slowly changing phases.

        See `Effect.recurrence`; tones above half of the sample rate appear as their aliases.
        """
        multiples = np.arange(1, 2 + len(self.harmonic_cosines_um))
        phases = 2.0 * np.pi * self.frequency_hz * np.outer(time_s, multiples)
        tones = np.hstack([np.cos(phases), np.sin(phases)])
        waves = np.cos(np.pi * np.outer(time_s / duration_s, np.arange(WANDERING)))
        return np.einsum("nt,nw->ntw", tones, waves).reshape(time_s.size, -1)

    @classmethod
    def bounds(cls, extent: Extent) -> dict[str, tuple[float, float]]:
        """Bound the parameters to a tone that the samples can show, within the measured range."""
        names = ("cosine_um", "sine_um", "harmonic_cosines_um", "harmonic_sines_um")
        return {"frequency_hz": (1.0 / extent.duration_s, 0.5 / extent.sample_period_s)} | {
            name: (-extent.travel_um, extent.travel_um) for name in names}

    @classmethod
    def starts(cls, evidence: Evidence) -> list[Self]:
        """Start with the largest line of the residual that the voltage does not drive."""
        size = _lines(evidence.residual_um)
        driven = _lines(evidence.displacement_um) ** 2
        for line in np.flatnonzero(driven > DRIVEN * driven.sum()).tolist():
            size[max(0, line - LINE_BINS) : line + LINE_BINS + 1] = 0.0
        size[:FEWEST_PERIODS] = 0.0
        size[-2:] = 0.0
        if size.size <= FEWEST_PERIODS + 2:
            return []
        peak = int(np.argmax(size))
        below, at, above = np.log(size[peak - 1 : peak + 2] + 1e-300)
        offset = np.clip(0.5 * (below - above) / (below - 2.0 * at + above + 1e-300), -0.5, 0.5)
        frequency_hz = (peak + offset) / evidence.duration_s
        starts = []
        for count in (0, HARMONICS):
            if (count + 1) * frequency_hz * evidence.sample_period_s < 0.5:
                shape = cls(frequency_hz, 0.0, 0.0, (0.0,) * count, (0.0,) * count)
                gains, _ = evidence.reduction(
                    shape._tones(evidence.residual_um.size, evidence.sample_period_s)
                )
                cosines, sines = np.split(gains, 2)
                starts.append(
                    cls(frequency_hz, cosines[0], sines[0], tuple(cosines[1:]), tuple(sines[1:]))
                )
        return starts


def _lines(signal: FloatArray) -> FloatArray:
    """Return the magnitude of the spectrum, without the mean."""
    return np.abs(np.fft.rfft((signal - signal.mean()) * np.hanning(signal.size)))
