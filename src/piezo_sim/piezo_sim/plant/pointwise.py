# SPDX-License-Identifier: BSD-3-Clause
"""Effects without memory: every output sample depends only on its own input sample."""

from collections.abc import Callable

import numpy as np

from piezo_common.arrays import FloatArray


class PointwiseRunner:
    """A compiled function of the samples and of constants.

    It is called as ``replace(samples, *constants)``, and replaces the inputs by the outputs.
    """

    def __init__(self, replace: Callable[..., None], *constants: float) -> None:
        self._replace = replace
        self._constants = constants

    def rest(self, level: float) -> float:
        """Return the output at the constant input `level`."""
        samples = np.array([level])
        self.apply(samples)
        return float(samples[0])

    def apply(self, samples: FloatArray) -> None:
        """Replace inputs by outputs."""
        self._replace(samples, *self._constants)
