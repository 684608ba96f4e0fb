# SPDX-License-Identifier: BSD-3-Clause
"""Mains hum: a frequency and its harmonics whose phase drifts slightly."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import (
    NOT_NEGATIVE,
    POSITIVE,
    Bounded,
    Surroundings,
    parameter,
    require,
)
from piezo_sim.plant.random_stream import NormalStream, bits_for
from piezo_sim.plant.state_runner import StateRunner


@njit(cache=True)
def _hum(samples: FloatArray, normals: FloatArray, phase: float, amplitudes_um: FloatArray,
         step: float, walk: float) -> tuple[float]:
    for n in range(samples.size):
        value = 0.0
        for k in range(amplitudes_um.size):
            value += amplitudes_um[k] * math.sin((k + 1) * phase)
        samples[n] += value
        phase = (phase + step + walk * normals[n]) % (2.0 * math.pi)
    return (phase,)


@dataclass(frozen=True)
class MainsHum(Bounded):
    """Sines at the frequency and its multiples; their common phase starts at random and drifts."""

    name: ClassVar[str] = "mains_hum"

    frequency_hz: float = parameter("Hz", POSITIVE)
    amplitudes_um: tuple[float, ...] = parameter("um")
    phase_walk_rad_per_sqrt_s: float = parameter("rad/s^0.5", NOT_NEGATIVE)

    def __post_init__(self) -> None:
        super().__post_init__()
        require(len(self.amplitudes_um) > 0, self, "amplitudes_um must hold a number.")

    def start(self, surroundings: Surroundings) -> StateRunner:
        """Start the phase from the seed; it does not depend on the displacement."""
        period_s, bits = surroundings.sample_period_s, bits_for(self.name, surroundings.seed)
        phase = np.random.Generator(bits).uniform(0.0, 2.0 * math.pi)
        return StateRunner(
            _hum, lambda level: ((phase,), level),
            (np.array(self.amplitudes_um), 2.0 * math.pi * self.frequency_hz * period_s,
             self.phase_walk_rad_per_sqrt_s * math.sqrt(period_s)), NormalStream(bits))
