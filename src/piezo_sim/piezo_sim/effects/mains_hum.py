# SPDX-License-Identifier: BSD-3-Clause
"""Mains hum: a frequency and its harmonics whose phase drifts slightly."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import Surroundings, parameter, require
from piezo_sim.plant.random_stream import NormalStream, bits_for


@njit(cache=True)
def _hum(samples: FloatArray, normals: FloatArray, phase: float, amplitudes_um: FloatArray,
         step: float, walk: float) -> float:
    for n in range(samples.size):
        value = 0.0
        for k in range(amplitudes_um.size):
            value += amplitudes_um[k] * math.sin((k + 1) * phase)
        samples[n] += value
        phase = (phase + step + walk * normals[n]) % (2.0 * math.pi)
    return phase


@dataclass(frozen=True)
class MainsHum:
    """Sines at the frequency and its multiples; their common phase starts at random and drifts."""

    name: ClassVar[str] = "mains_hum"

    frequency_hz: float = parameter("Hz")
    amplitudes_um: tuple[float, ...] = parameter("um")
    phase_walk_rad_per_sqrt_s: float = parameter("rad/s^0.5")

    def __post_init__(self) -> None:
        require(self.frequency_hz > 0.0, self, "frequency_hz must be positive.")
        require(len(self.amplitudes_um) > 0, self, "amplitudes_um must hold a number.")
        require(
            self.phase_walk_rad_per_sqrt_s >= 0.0,
            self,
            "phase_walk_rad_per_sqrt_s must not be negative.",
        )

    def start(self, surroundings: Surroundings) -> "HumRunner":
        """Start the phase from the seed."""
        return HumRunner(self, surroundings)


class HumRunner:
    """Hum with its phase as state."""

    def __init__(self, effect: MainsHum, surroundings: Surroundings) -> None:
        period_s = surroundings.sample_period_s
        bits = bits_for(effect.name, surroundings.seed)
        self._phase = np.random.Generator(bits).uniform(0.0, 2.0 * math.pi)
        self._normals = NormalStream(bits)
        self._constants = (
            np.array(effect.amplitudes_um),
            2.0 * math.pi * effect.frequency_hz * period_s,
            effect.phase_walk_rad_per_sqrt_s * math.sqrt(period_s),
        )

    def rest(self, level: float) -> float:
        """Return the level unchanged, as hum is independent of rest."""
        return level

    def apply(self, samples: FloatArray) -> None:
        """Add the hum to displacements."""
        normals = self._normals.next(samples.size)
        self._phase = _hum(samples, normals, self._phase, *self._constants)
