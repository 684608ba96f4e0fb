# SPDX-License-Identifier: BSD-3-Clause
"""The evidence that an error has grown since some time, against that it is as it usually is.

The Bayes factors of all beginnings and all factors of growth are added up (Shiryaev 1963; Roberts
1966). While nothing has changed, their sum exceeds a threshold A no sooner than after A blocks in
the mean, whatever the blocks' distribution is, as it then grows by one a block in the mean (M.
Pollak, Annals of Statistics 15, 1987).
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln

from piezo_common.arrays import FloatArray
from piezo_identification.monitoring.usual_error import Expected

FACTORS = np.geomspace(2.5, 250.0, 19)
"""By which an error may have grown, each as likely as any other: one that has doubled is nearer to
the least of them than to none."""

STRAY, STRAY_RANGE = 0.05, 10.0
"""Part of the blocks whose error has any size, such as by a spike, and the range of the logarithm
in which it lies: a block alone shows no change."""


@dataclass(frozen=True)
class Change:
    """What the evidence says of a change.

    Attributes
    ----------
    blocks : int
        Since its beginning.
    factor : float
        By which the error has grown, at the most likely.
    logarithm : float
        Of the Bayes factor.
    """

    blocks: int
    factor: float
    logarithm: float


class ChangeEvidence:
    """Sums of the Bayes factors of every beginning, one for each factor of growth."""

    def __init__(self) -> None:
        self._growth = np.log(FACTORS)
        self._step = float(self._growth[1] - self._growth[0])
        self._logarithms = np.full(FACTORS.size, -np.inf)
        self._blocks = np.zeros(FACTORS.size, dtype=int)

    def add(self, value: float, expected: Expected) -> Change:
        """Add a block, and return what all say.

        Parameters
        ----------
        value : float
            Logarithm of its error.
        expected : Expected
            As it usually is.
        """
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
    """Return the logarithm of the density of a block's error, stray ones included."""
    away = (value - middle) / scale
    student = (gammaln(0.5 * (freedom + 1.0)) - gammaln(0.5 * freedom)
               - 0.5 * np.log(np.pi * freedom) - np.log(scale)
               - 0.5 * (freedom + 1.0) * np.log1p(away**2 / freedom))
    return np.logaddexp(np.log1p(-STRAY) + student, np.log(STRAY / STRAY_RANGE))
