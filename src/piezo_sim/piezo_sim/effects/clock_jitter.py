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
from piezo_sim.plant.plant_effect import NOT_NEGATIVE, Bounded, Surroundings, parameter
from piezo_sim.plant.random_stream import NormalStream, bits_for
from piezo_sim.plant.state_runner import StateRunner, unmoved


@njit(cache=True)
def _deviate(samples: FloatArray, normals: FloatArray, previous: float,
             rms_share: float) -> tuple[float]:
    for n in range(samples.size):
        level = samples[n]
        share = min(abs(normals[n]) * rms_share, 1.0)
        samples[n] = level + (previous - level) * share
        previous = level
    return (previous,)


@dataclass(frozen=True)
class Jitter(Bounded):
    """Deviations from the ticks at random."""

    name: ClassVar[str]

    jitter_rms_s: float = parameter("s", NOT_NEGATIVE)

    def start(self, surroundings: Surroundings) -> StateRunner:
        """Start the deviations from the seed; at rest, they have no effect."""
        return StateRunner(_deviate, unmoved, (self.jitter_rms_s / surroundings.sample_period_s,),
                           NormalStream(bits_for(self.name, surroundings.seed)))


class UpdateJitter(Jitter):
    """Updates of the voltage that are late at random."""

    name = "update_jitter"


class SamplingJitter(Jitter):
    """Readings of the displacement that are early at random."""

    name = "sampling_jitter"
