# SPDX-License-Identifier: BSD-3-Clause
"""Structured singular value: the size of structured perturbations that a loop tolerates."""

import control
import numpy as np
from slycot import ab13md

from piezo_common.arrays import ComplexArray, FloatArray

COMPLEX = 2


def structured_singular_values(responses: ComplexArray,
                               scalars: int) -> tuple[FloatArray, FloatArray]:
    """Return the upper bound of the structured singular value at each frequency, with its scalings.

    The structure is `scalars` independent complex numbers, followed by one full complex block, the
    performance, from all other inputs to all other outputs; it is padded with zeros to be square.
    The responses M have the shape (F, outputs, inputs). The scalings, (F, scalars), are positive d
    such that the largest singular value of ``D M D^-1`` with ``D = diag(d, 1)`` is the bound.
    """
    frequencies, outputs, inputs = responses.shape
    size = max(outputs, inputs)
    square = np.zeros((frequencies, size, size), dtype=complex)
    square[:, :outputs, :inputs] = responses
    blocks = [1] * scalars + [size - scalars]
    kinds = [COMPLEX] * len(blocks)
    mu, scalings = np.empty(frequencies), np.empty((frequencies, scalars))
    found = None
    for index, matrix in enumerate(square):
        # Where the bound of one frequency was found, the next one begins.
        mu[index], d, _, found = ab13md(matrix, blocks, kinds, found)
        scalings[index] = d[:scalars] / d[-1]
    return mu, scalings


def sampled_response(system: control.StateSpace, points: ComplexArray) -> ComplexArray:
    """Return the response of a discrete system on the z plane, shape (points, outputs, inputs)."""
    return np.moveaxis(system(points, squeeze=False), -1, 0)
