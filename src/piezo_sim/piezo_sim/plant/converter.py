# SPDX-License-Identifier: BSD-3-Clause
"""Levels of a digital-to-analogue or analogue-to-digital converter."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from piezo_common.arrays import FloatArray


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
