# SPDX-License-Identifier: BSD-3-Clause
"""Simulation of a discrete system by blocks of samples, as products of matrices.

A recursion processes one sample after the other. Within a block the output is linear in the block's
input and in the state at its start (Burrus 1972), and so is the state after it.
"""

from functools import lru_cache

import numpy as np
from numba import njit
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray

LENGTH = 32
"""Samples of a block, a power of two; a longer block needs more products, a shorter one more
states."""

FEWEST = 64 * LENGTH
"""Smallest number of samples for which computing the matrices of a block is worthwhile."""

BATCH = 512
"""Blocks of a batch, which fit into the cache."""

KEPT = 16
"""Systems whose matrices are cached, 0.04 MB for each output; a fit simulates many inputs of a few
systems at a time."""

LONG = 64
"""Samples of a block if only some are needed, which makes the states a larger part of the cost."""

MANY = 0.4
"""Share of the samples above which all are computed, which needs no selection of blocks."""


def run_blocks(a: FloatArray, b: FloatArray, c: FloatArray, direct: float, samples: FloatArray,
               state: FloatArray, output: FloatArray) -> int:
    """Simulate all whole blocks, and return their number of samples, a multiple of `LENGTH`.

    The system is x[k + 1] = a x[k] + b v[k], y[k] = c x[k] + direct v[k]. The state at the first
    sample is updated in place to that after the last block; the output is filled with that of the
    blocks.
    """
    gains, outputs, answers, transposed = _block(a, b, c[None], np.array([direct]), LENGTH)
    done = samples.size // LENGTH * LENGTH
    blocks, behind = (each[:done].reshape(-1, LENGTH) for each in (samples, output))
    for begin in range(0, len(blocks), BATCH):
        batch = blocks[begin : begin + BATCH]
        states = _states(transposed, batch @ gains, state)
        np.matmul(batch, answers[0], out=behind[begin : begin + BATCH])
        behind[begin : begin + BATCH] += states @ outputs[0]
    return done


def outputs_in_blocks(a: FloatArray, b: FloatArray, c: FloatArray, direct: FloatArray,
                      samples: FloatArray, state: FloatArray,
                      at: NDArray[np.intp]) -> FloatArray:
    """Return the outputs of a system with several outputs at a few samples, sorted, (m, outputs).

    Only the blocks of `LONG` samples that contain such samples are computed. `c` is (outputs, n),
    `direct` is (outputs,); the state at the first sample is overwritten.
    """
    if len(c) == 1 and at.size > MANY * samples.size:
        # The outputs do not depend on the samples after them.
        padded = np.concatenate([samples, np.zeros(-samples.size % LENGTH)])
        every = np.empty(padded.size)
        run_blocks(a, b, c[0], direct[0], padded, state, every)
        return every[at, np.newaxis]
    gains, outputs, answers, transposed = _block(a, b, c, direct, LONG)
    found = np.empty((at.size, len(c)))
    last = at[-1] + 1 if at.size else 0
    for begin in range(0, last, BATCH * LONG):
        batch = samples[begin : begin + BATCH * LONG]
        blocks = np.concatenate([batch, np.zeros(-batch.size % LONG)]).reshape(-1, LONG)
        states = _states(transposed, blocks @ gains, state)
        asked = slice(*np.searchsorted(at, [begin, begin + BATCH * LONG]))
        number, place = np.divmod(at[asked] - begin, LONG)
        is_first = np.diff(number, prepend=-1) > 0
        blocks, states = blocks[number[is_first]], states[number[is_first]]
        place += LONG * (np.cumsum(is_first) - 1)
        for output, (own, of_states) in enumerate(zip(answers, outputs, strict=True)):
            found[asked, output] = (blocks @ own + states @ of_states).ravel()[place]
    return found


def _block(a: FloatArray, b: FloatArray, c: FloatArray, direct: FloatArray, length: int,
           ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the matrices of a block, and a^length transposed.

    The input of a block times the first matrix, (length, n), is its part of the state behind it.
    The others, (outputs, n, length) and (outputs, length, length), give the outputs from the state
    at its start and from its input. All are cached and shared, since one system is often simulated
    with many inputs. Do not change them.
    """
    return _block_of(a.tobytes(), b.tobytes(), c.tobytes(), direct.tobytes(), length)


@lru_cache(maxsize=KEPT)
def _block_of(a_bytes: bytes, b_bytes: bytes, c_bytes: bytes, direct_bytes: bytes, length: int,
              ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    b, direct = np.frombuffer(b_bytes), np.frombuffer(direct_bytes)
    a, c = np.frombuffer(a_bytes).reshape(-1, b.size), np.frombuffer(c_bytes).reshape(-1, b.size)
    driven, transposed = _sequence(b[None], np.ascontiguousarray(a.T), length)
    outputs = np.ascontiguousarray(_sequence(c, a, length)[0].transpose(1, 2, 0))
    impulse = np.column_stack([np.zeros((len(c), length - 1)), direct, b @ outputs[:, :, :-1]])
    answers = np.ascontiguousarray(sliding_window_view(impulse, length, axis=1)[:, ::-1])
    return np.ascontiguousarray(driven[::-1, 0]), outputs, answers, transposed


def _sequence(rows: FloatArray, a: FloatArray, length: int) -> tuple[FloatArray, FloatArray]:
    """Return rows a^k for each k below length, a power of two, (length, rows, n), and a^length."""
    sequence, power = rows[None], a
    while len(sequence) < length:
        sequence, power = np.concatenate([sequence, sequence @ power]), power @ power
    return sequence, power


@njit(cache=True, nogil=True)
def _states(transposed: FloatArray, driven: FloatArray, state: FloatArray) -> FloatArray:
    """Return the states at the start of each block; update `state` to that after the last."""
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
