# SPDX-License-Identifier: BSD-3-Clause
"""Converters that do not act exactly at the ticks of the clock.

Let tau be the deviation from the tick: ``|normal|`` times the given RMS, and at most one period T.
A sample becomes s[n] + (s[n-1] - s[n]) tau / T. For a held voltage this is the mean over the period
if the update is late by tau. For a displacement it is linear interpolation at a time earlier by
tau.
"""

from dataclasses import dataclass
from typing import ClassVar

from numba import njit

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import Surroundings, parameter, require
from piezo_sim.plant.random_stream import NormalStream, bits_for


@njit(cache=True)
def _deviate(samples: FloatArray, normals: FloatArray, previous: float,
             rms_share: float) -> float:
    for n in range(samples.size):
        level = samples[n]
        share = min(abs(normals[n]) * rms_share, 1.0)
        samples[n] = level + (previous - level) * share
        previous = level
    return previous


@dataclass(frozen=True)
class Jitter:
    """Deviations from the ticks at random."""

    name: ClassVar[str]

    jitter_rms_s: float = parameter("s")

    def __post_init__(self) -> None:
        require(self.jitter_rms_s >= 0.0, self, "jitter_rms_s must not be negative.")

    def start(self, surroundings: Surroundings) -> "JitterRunner":
        """Start the deviations from the seed."""
        return JitterRunner(self, surroundings)


class UpdateJitter(Jitter):
    """Updates of the voltage that are late at random."""

    name = "update_jitter"


class SamplingJitter(Jitter):
    """Readings of the displacement that are early at random."""

    name = "sampling_jitter"


class JitterRunner:
    """Jitter with the previous sample as its state."""

    def __init__(self, effect: Jitter, surroundings: Surroundings) -> None:
        self._rms_share = effect.jitter_rms_s / surroundings.sample_period_s
        self._normals = NormalStream(bits_for(effect.name, surroundings.seed))
        self._previous = 0.0

    def rest(self, level: float) -> float:
        """Rest at the constant input `level`, where a deviation in time has no effect."""
        self._previous = level
        return level

    def apply(self, samples: FloatArray) -> None:
        """Replace samples by those at the deviating instants."""
        normals = self._normals.next(samples.size)
        self._previous = _deviate(samples, normals, self._previous, self._rms_share)
