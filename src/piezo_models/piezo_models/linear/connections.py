# SPDX-License-Identifier: BSD-3-Clause
"""Series and parallel connections of linear systems, by their matrices.

The results are identical to those of python-control's operators. Those check and name each system,
which takes longer than a simulation of thousands of samples.
"""

from collections.abc import Iterable, Sequence
from functools import reduce

import control
import numpy as np
from scipy.linalg import block_diag

from piezo_common.arrays import FloatArray

Matrices = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""A, B, C and D of a continuous system with one input, and one output unless stated."""


def matrices_of(system: control.StateSpace) -> Matrices:
    """Return the matrices of a system."""
    return system.A, system.B, system.C, system.D


def in_series(systems: Iterable[Matrices]) -> Matrices:
    """Return the series connection, the first system first; the identity for no system."""
    return reduce(_followed_by, systems, _passing_on())


def in_parallel(systems: Sequence[Matrices]) -> Matrices:
    """Return the parallel connection of at least one system: the sum of their outputs."""
    return reduce(_parallel, systems)


def with_all_outputs(systems: Sequence[Matrices]) -> Matrices:
    """Return systems with a common input as one; its outputs are theirs, one after the other."""
    a, b, c, d = zip(*systems, strict=True)
    return block_diag(*a), np.vstack(b), block_diag(*c), np.vstack(d)


def scaled(gain: float, system: Matrices) -> Matrices:
    """Return a system whose input is multiplied by a gain."""
    a, b, c, d = system
    return a, gain * b, c, gain * d


def inverse(system: control.StateSpace) -> control.StateSpace:
    """Return the inverse of a system that passes its input on at once, in the same states."""
    direct = np.linalg.inv(system.D)
    return control.ss(system.A - system.B @ direct @ system.C, system.B @ direct,
                      -direct @ system.C, direct, system.dt)


def _passing_on() -> Matrices:
    return np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1))


def _followed_by(first: Matrices, second: Matrices) -> Matrices:
    (a1, b1, c1, d1), (a2, b2, c2, d2) = first, second
    return (_of_blocks(a1, np.zeros((len(a1), len(a2))), b2 @ c1, a2),
            np.concatenate([b1, b2 @ d1]), np.concatenate([d2 @ c1, c2], axis=1), d2 @ d1)


def _parallel(first: Matrices, second: Matrices) -> Matrices:
    (a1, b1, c1, d1), (a2, b2, c2, d2) = first, second
    nothing = np.zeros((len(a1), len(a2)))
    return (_of_blocks(a1, nothing, nothing.T, a2), np.concatenate([b1, b2]),
            np.concatenate([c1, c2], axis=1), d1 + d2)


def _of_blocks(top_left: FloatArray, top_right: FloatArray, bottom_left: FloatArray,
               bottom_right: FloatArray) -> FloatArray:
    top = np.concatenate([top_left, top_right], axis=1)
    return np.concatenate([top, np.concatenate([bottom_left, bottom_right], axis=1)])
