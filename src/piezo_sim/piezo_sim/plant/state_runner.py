# SPDX-License-Identifier: BSD-3-Clause
"""Runner of effects that a compiled function advances."""

from collections.abc import Callable
from typing import Any

from piezo_common.arrays import FloatArray
from piezo_sim.plant.random_stream import NormalStream

Rested = tuple[tuple[Any, ...], float]
"""State and output of an effect at rest."""


def unmoved(level: float) -> Rested:
    """Return the rest of an effect whose state is its last input, which it passes on."""
    return (level,), level


class StateRunner:
    """A compiled function of the samples, of its state and of constants.

    It is called as ``replace(samples, *state, *constants)``, replaces the inputs by the outputs,
    and returns the new state, a tuple. With normals, an array of them, one for each sample, follows
    the samples. `at_rest` returns the state and the output at a constant input.
    """

    def __init__(self, replace: Callable[..., tuple[Any, ...]], at_rest: Callable[[float], Rested],
                 constants: tuple[Any, ...] = (), normals: NormalStream | None = None) -> None:
        self._replace, self._at_rest = replace, at_rest
        self._constants, self._normals = constants, normals
        self._state, _ = at_rest(0.0)

    def rest(self, level: float) -> float:
        """Set the state at the constant input `level`; return the output."""
        self._state, output = self._at_rest(level)
        return output

    def apply(self, samples: FloatArray) -> None:
        """Replace inputs by outputs."""
        drawn = () if self._normals is None else (self._normals.next(samples.size),)
        self._state = self._replace(samples, *drawn, *self._state, *self._constants)
