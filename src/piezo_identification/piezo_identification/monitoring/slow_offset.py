# SPDX-License-Identifier: BSD-3-Clause
"""The deviation of the mean of a residual from the usual creep error of a model.

For any stage, creep that a model lacks grows with the logarithm of the time since a run began. The
means are therefore expected on a line over that logarithm. The line also follows slow warming.
"""

import numpy as np

from piezo_common.arrays import FloatArray

FOLLOWED_BLOCKS = 100
"""Number of blocks to which the line is fitted; older ones fade."""

FEWEST_BLOCKS = 3
"""Number of blocks after which a deviation is computed; before, it is 0."""

SETTLED_BLOCKS = 10
"""Number of blocks after which the line is known and the age of a run no longer counts."""


class SlowOffset:
    """Least-squares line through the means of a run over log time, with older ones fading."""

    def __init__(self) -> None:
        self.begin()

    def begin(self) -> None:
        """Start a new run."""
        self._blocks = 0
        self._normal: FloatArray = np.zeros((2, 2))
        self._right: FloatArray = np.zeros(2)

    @property
    def age(self) -> float:
        """Return the logarithm of the blocks in the run, limited to `SETTLED_BLOCKS`."""
        return float(np.log(min(self._blocks, SETTLED_BLOCKS)))

    def take(self, mean_um: float) -> float:
        """Add the mean of the next block, and return its deviation from the line (um)."""
        self._blocks += 1
        at = np.array([1.0, np.log(self._blocks)])
        offset_um = 0.0
        if self._blocks > FEWEST_BLOCKS:
            offset_um = mean_um - float(at @ np.linalg.solve(self._normal, self._right))
        kept = 1.0 - 1.0 / FOLLOWED_BLOCKS
        self._normal = kept * self._normal + np.outer(at, at)
        self._right = kept * self._right + mean_um * at
        return offset_um
