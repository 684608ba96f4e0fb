# SPDX-License-Identifier: BSD-3-Clause
"""Mean output of a linear system with a repeated input, without simulating every period."""

import control
import numpy as np

from piezo_models.linear.dynamics import continue_linear


def mean_over_repeats(system: control.StateSpace, once: np.ndarray, period: np.ndarray,
                      repeats: int) -> float:
    """Return the mean output while an input is repeated, after another input is played once.

    The state at the beginning of a period and the sum of the outputs so far follow from those of
    the previous period by an affine map; a power of its matrix covers all periods. The system is
    discrete, with one input and one output, and all its states are initially zero.
    """
    n = system.nstates
    _, first_state = continue_linear(system, once, np.zeros(n))
    output, driven = continue_linear(system, period, np.zeros(n))
    # Map from the state at a period's beginning to that at its end and to the sum of its outputs.
    free = np.linalg.matrix_power(
        np.block([[system.A, np.zeros((n, 1))], [system.C, np.ones((1, 1))]]), len(period))
    step = np.zeros((n + 2, n + 2))
    step[:n, :n], step[:n, n] = free[:n, :n], driven
    step[n, n] = step[n + 1, n + 1] = 1.0
    step[n + 1, :n], step[n + 1, n] = free[n, :n], output.sum()
    end = np.linalg.matrix_power(step, repeats) @ np.r_[first_state, 1.0, 0.0]
    return float(end[-1] / (repeats * len(period)))
