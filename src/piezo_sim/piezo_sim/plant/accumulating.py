# SPDX-License-Identifier: BSD-3-Clause
"""Effects whose state is the last input and one quantity that accumulates with the motion."""

from collections.abc import Callable

from piezo_common.arrays import FloatArray


class AccumulatingRunner:
    """A compiled function of the samples, of its state and of constants.

    Parameters
    ----------
    replace : callable
        Called as ``replace(samples, last, gathered, *constants)``; replaces the inputs by the
        outputs and returns the new state ``last, gathered``.
    """

    def __init__(self, replace: Callable[..., tuple[float, float]], *constants: float) -> None:
        self._replace = replace
        self._constants = constants
        self._state = (0.0, 0.0)

    def rest(self, level: float) -> float:
        """Set the constant input `level`, with nothing accumulated; the output is the input."""
        self._state = (level, 0.0)
        return level

    def apply(self, samples: FloatArray) -> None:
        """Replace inputs by outputs."""
        self._state = self._replace(samples, *self._state, *self._constants)
