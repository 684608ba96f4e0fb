# SPDX-License-Identifier: BSD-3-Clause
"""Effects that remember their last input, and one quantity that gathers as the input moves."""

from collections.abc import Callable

from piezo_common.arrays import FloatArray


class AccumulatingRunner:
    """A compiled function of the samples, of the two things remembered and of constants.

    Parameters
    ----------
    replace : callable
        ``replace(samples, last, gathered, *constants)`` puts the outputs in place of the inputs
        and returns the new ``last, gathered``.
    constants : float
        Parameters of the effect.
    """

    def __init__(self, replace: Callable[..., tuple[float, float]], *constants: float) -> None:
        self._replace = replace
        self._constants = constants
        self._state = (0.0, 0.0)

    def rest(self, level: float) -> float:
        """Stand at the constant input `level`, with nothing gathered; the output is the input."""
        self._state = (level, 0.0)
        return level

    def apply(self, samples: FloatArray) -> None:
        """Replace inputs by outputs."""
        self._state = self._replace(samples, *self._state, *self._constants)
