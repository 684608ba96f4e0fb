# SPDX-License-Identifier: BSD-3-Clause
"""By how much the mean of a residual departs from the creep that a model ordinarily leaves.

Creep that a model lacks goes with the logarithm of the time since a run began, whatever the stage
is made of. So means are expected on a line over that logarithm, which follows slow warming.
"""

import numpy as np

from piezo_common.arrays import FloatArray

FOLLOWED_BLOCKS = 100
"""From which the line is fitted; older ones fade."""

FEWEST_BLOCKS = 3
"""Before which any mean is as expected."""

SETTLED_BLOCKS = 10
"""After which a run is no longer young: the line is known."""


class SlowOffset:
    """Least squares of the means of a run on the logarithm of their time, older ones fading."""

    def __init__(self) -> None:
        self.begin()

    def begin(self) -> None:
        """Begin another run."""
        self._blocks = 0
        self._normal: FloatArray = np.zeros((2, 2))
        self._right: FloatArray = np.zeros(2)

    @property
    def age(self) -> float:
        """Return the logarithm of the blocks of the run, until it has settled."""
        return float(np.log(min(self._blocks, SETTLED_BLOCKS)))

    def take(self, mean_um: float) -> float:
        """Take the mean of the next block; return by how much it departs (um)."""
        self._blocks += 1
        at = np.array([1.0, np.log(self._blocks)])
        offset_um = 0.0
        if self._blocks > FEWEST_BLOCKS:
            offset_um = mean_um - float(at @ np.linalg.solve(self._normal, self._right))
        kept = 1.0 - 1.0 / FOLLOWED_BLOCKS
        self._normal = kept * self._normal + np.outer(at, at)
        self._right = kept * self._right + mean_um * at
        return offset_um
