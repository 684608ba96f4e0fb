# SPDX-License-Identifier: BSD-3-Clause
"""The evidence that an error has grown since some time, compared with its usual size.

The Bayes factors of all times of change and all factors of growth are summed (Shiryaev 1963;
Roberts 1966). Without a change, this sum grows by one per block on average, whatever the
distribution of the blocks. It therefore takes at least A blocks on average to exceed a threshold A
(M. Pollak, Annals of Statistics 15, 1987).
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln

from piezo_common.arrays import FloatArray
from piezo_identification.monitoring.usual_error import Expected

FACTORS = np.geomspace(2.5, 250.0, 19)
"""Factors by which an error may have grown, all equally likely. An error that has doubled is nearer
to the smallest factor than to no growth."""

STRAY, STRAY_RANGE = 0.05, 10.0
"""Fraction of blocks with an error of any size, for example from a spike, and the range of the
logarithm of that error. They keep a single block from indicating a change."""


@dataclass(frozen=True)
class Change:
    """The evidence for a change."""

    blocks: int
    """Number of blocks since the most likely beginning."""
    factor: float
    """Most likely factor by which the error has grown."""
    logarithm: float
    """Logarithm of the Bayes factor."""


class ChangeEvidence:
    """Sums of the Bayes factors over all beginnings, one for each factor of growth."""

    def __init__(self) -> None:
        self._growth = np.log(FACTORS)
        self._step = float(self._growth[1] - self._growth[0])
        self._logarithms = np.full(FACTORS.size, -np.inf)
        self._blocks = np.zeros(FACTORS.size, dtype=int)

    def add(self, value: float, expected: Expected) -> Change:
        """Add the logarithm of the error (um) of a block, and return the evidence of all blocks."""
        usual = _log_density(value, expected.middle, expected.scale, expected.freedom)
        grown = _log_density(value, expected.middle + self._growth,
                             np.hypot(expected.scale, 0.5 * self._step), expected.freedom)
        self._blocks = np.where(self._logarithms > 0.0, self._blocks + 1, 1)
        self._logarithms = np.logaddexp(0.0, self._logarithms) + grown - usual
        likely = int(np.argmax(self._logarithms))
        return Change(int(self._blocks[likely]), float(FACTORS[likely]), float(
            np.logaddexp.reduce(self._logarithms) - np.log(FACTORS.size)))


def _log_density(value: float, middle: FloatArray | float, scale: FloatArray | float,
                 freedom: float) -> FloatArray:
    """Return the log density of a block's error, including blocks with stray errors."""
    away = (value - middle) / scale
    student = (gammaln(0.5 * (freedom + 1.0)) - gammaln(0.5 * freedom)
               - 0.5 * np.log(np.pi * freedom) - np.log(scale)
               - 0.5 * (freedom + 1.0) * np.log1p(away**2 / freedom))
    return np.logaddexp(np.log1p(-STRAY) + student, np.log(STRAY / STRAY_RANGE))
