# SPDX-License-Identifier: BSD-3-Clause
"""Simulation of a discrete system by blocks of samples, which are products of matrices.

A recursion from sample to sample waits for each of them. Within a block the output is linear in
the block's input and in the state at its start (Burrus 1972), and so is the state behind it.
"""

import numpy as np
from numba import njit

from piezo_common.arrays import FloatArray

LENGTH = 32
"""Samples of a block: a longer one takes more products, a shorter one more states."""

FEWEST = 64 * LENGTH
"""Samples of an input from which the matrices of a block are worth their computation."""

BATCH = 512
"""Blocks at a time: as many as the cache holds."""


def run_blocks(a: FloatArray, b: FloatArray, c: FloatArray, direct: float, samples: FloatArray,
               state: FloatArray, output: FloatArray) -> int:
    """Simulate as many whole blocks as there are, and return how many samples they are.

    Parameters
    ----------
    a : (n, n) array
    b, c : (n,) array
    direct : float
        Of x[k + 1] = a x[k] + b v[k], y[k] = c x[k] + direct v[k].
    samples : (N,) array
    state : (n,) array
        At the first sample; updated in place to that behind the last block.
    output : (N,) array
        Gets the output of the blocks.

    Returns
    -------
    int
        A multiple of `LENGTH`.
    """
    gains, outputs, answers, transposed = _block(a, b, c, direct)
    done = samples.size // LENGTH * LENGTH
    blocks, behind = samples[:done].reshape(-1, LENGTH), output[:done].reshape(-1, LENGTH)
    for begin in range(0, len(blocks), BATCH):
        batch = blocks[begin : begin + BATCH]
        states = _states(transposed, batch @ gains, state)
        np.matmul(batch, answers, out=behind[begin : begin + BATCH])
        behind[begin : begin + BATCH] += states @ outputs
    return done


def _block(a: FloatArray, b: FloatArray, c: FloatArray, direct: float,
           ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return what turns input and state into next state and output, and a^LENGTH, transposed."""
    gains, outputs = np.empty((LENGTH, b.size)), np.empty((b.size, LENGTH))
    impulse, driven, seen = np.empty(LENGTH), b, c
    for k in range(LENGTH):
        gains[LENGTH - 1 - k], outputs[:, k] = driven, seen
        impulse[k] = seen @ b
        driven, seen = a @ driven, seen @ a
    answers = np.diag(np.full(LENGTH, direct))
    for k in range(1, LENGTH):
        answers += np.diag(np.full(LENGTH - k, impulse[k - 1]), k)
    power = np.linalg.matrix_power(a, LENGTH)
    return gains, outputs, answers, np.ascontiguousarray(power.T)


@njit(cache=True, nogil=True)
def _states(transposed: FloatArray, driven: FloatArray, state: FloatArray) -> FloatArray:
    """Return the states at the start of each block; the given one moves behind the last."""
    states = np.empty(driven.shape)
    size = state.size
    for k in range(len(driven)):
        for i in range(size):
            states[k, i] = state[i]
            state[i] = driven[k, i]
        for j in range(size):
            x = states[k, j]
            for i in range(size):
                state[i] += transposed[j, i] * x
    return states
