# SPDX-License-Identifier: BSD-3-Clause
"""Output of a discrete system at a few samples of a long input."""

import control
import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_models.linear.block_simulation import LONG, blocks_at
from piezo_models.linear.dynamics import simulate_linear

FEW = 8
"""Samples per requested output, at least; if more outputs are requested, all are simulated."""


def simulate_linear_at(discrete_system: control.StateSpace, input: FloatArray,
                       initial_state: FloatArray, at: NDArray[np.intp]) -> FloatArray:
    """Simulate like `simulate_linear`, but return few of the outputs, (m,).

    The state at the first sample, (n,), is not changed. The samples `at` are sorted.
    """
    whole = input.size // LONG * LONG
    if not initial_state.size or FEW * at.size > input.size or not whole:
        return simulate_linear(discrete_system, input, initial_state)[at]
    a, direct = discrete_system.A, discrete_system.D[0, 0]
    b, c = discrete_system.B[:, 0], discrete_system.C[0]
    state, early = np.array(initial_state, dtype=float), np.searchsorted(at, whole)
    output_in_blocks = blocks_at(
        a, b, c, direct, np.ascontiguousarray(input[:whole]), state, at[:early])
    behind = simulate_linear(discrete_system, input[whole:], state)[at[early:] - whole]
    return np.concatenate([output_in_blocks, behind])
