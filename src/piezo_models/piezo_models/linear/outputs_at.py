# SPDX-License-Identifier: BSD-3-Clause
"""Outputs of a discrete system at a few samples of a long input."""

import control
import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_models.linear.block_simulation import outputs_in_blocks


def simulate_linear_at(discrete_system: control.StateSpace, input: FloatArray,
                       initial_state: FloatArray, at: NDArray[np.intp]) -> FloatArray:
    """Simulate like `simulate_linear`, but return few samples of all outputs, (m, outputs).

    The state at the first sample, (n,), is not changed. The samples `at` are sorted.
    """
    a, direct = discrete_system.A, discrete_system.D[:, 0]
    if not initial_state.size:
        return np.outer(input[at], direct)
    return outputs_in_blocks(a, discrete_system.B[:, 0], discrete_system.C, direct,
                             np.ascontiguousarray(input), np.array(initial_state, dtype=float), at)
