# SPDX-License-Identifier: BSD-3-Clause
"""Levels of a digital-to-analogue or analogue-to-digital converter."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import Effect, require


@njit(cache=True)
def _quantise(samples: FloatArray, low: float, step: float, highest: float) -> None:
    for n in range(samples.size):
        level = np.rint((samples[n] - low) / step)
        samples[n] = low + step * min(max(level, 0.0), highest)


@dataclass(frozen=True)
class Converter:
    """A converter whose levels divide the range from low to high evenly and include both ends."""

    low: float
    high: float
    bits: int

    def apply(self, samples: FloatArray) -> None:
        """Replace samples, float64 of shape (N,), by the nearest levels."""
        highest = 2.0**self.bits - 1.0
        _quantise(samples, self.low, (self.high - self.low) / highest, highest)


def converter_of(effect: Effect, low: str, high: str) -> Converter:
    """Return the converter of an effect whose `converter_bits` determine the number of levels.

    The lowest and the highest level have the given names among its parameters. PlantConfigError is
    raised if the range is empty, or there are too few or too many levels.
    """
    lowest, highest, bits = (getattr(effect, name) for name in (low, high, "converter_bits"))
    require(lowest < highest, effect, f"{low} must be below {high}.")
    require(1 <= bits <= 32, effect, "converter_bits must be an integer from 1 to 32.")
    return Converter(lowest, highest, bits)
