# SPDX-License-Identifier: BSD-3-Clause
"""Simulation of a discrete system by blocks of samples, as products of matrices.

A recursion processes one sample after the other. Within a block the output is linear in the block's
input and in the state at its start (Burrus 1972), and so is the state after it.
"""

from collections.abc import Iterator
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

KEPT = 64
"""Systems whose matrices are cached, 0.1 MB each; a fit uses some dozens for its recordings."""

LONG = 128
"""Samples of a block if few outputs are needed, which makes the states the main cost."""


def run_blocks(a: FloatArray, b: FloatArray, c: FloatArray, direct: float, samples: FloatArray,
               state: FloatArray, output: FloatArray) -> int:
    """Simulate all whole blocks, and return their number of samples, a multiple of `LENGTH`.

    The system is x[k + 1] = a x[k] + b v[k], y[k] = c x[k] + direct v[k]. The state at the first
    sample is updated in place to that after the last block; the output is filled with that of the
    blocks.
    """
    gains, outputs, impulse, transposed = _block(a, b, c, direct, LENGTH)
    answers = np.ascontiguousarray(
        sliding_window_view(np.concatenate([np.zeros(LENGTH - 1), impulse]), LENGTH)[::-1])
    done = samples.size // LENGTH * LENGTH
    behind = output[:done].reshape(-1, LENGTH)
    for begin, batch, states in _batches(samples[:done].reshape(-1, LENGTH), gains, transposed,
                                         state):
        np.matmul(batch, answers, out=behind[begin : begin + BATCH])
        behind[begin : begin + BATCH] += states @ outputs
    return done


def blocks_at(a: FloatArray, b: FloatArray, c: FloatArray, direct: float, samples: FloatArray,
              state: FloatArray, at: NDArray[np.intp]) -> FloatArray:
    """Simulate whole blocks of `LONG` samples; return the output at a few of their samples, sorted.

    For the other blocks only the states are computed, which saves most of the work and the memory.
    The system and its state are those of `run_blocks`.
    """
    gains, outputs, impulse, transposed = _block(a, b, c, direct, LONG)
    output, latest_first = np.empty(at.size), impulse[::-1].copy()
    for begin, batch, states in _batches(samples.reshape(-1, LONG), gains, transposed, state):
        asked = slice(*np.searchsorted(at, [begin * LONG, (begin + BATCH) * LONG]))
        _answer(batch.reshape(-1), states, latest_first, outputs, at[asked] - begin * LONG,
                output[asked])
    return output


def _batches(blocks: FloatArray, gains: FloatArray, transposed: FloatArray, state: FloatArray,
             ) -> Iterator[tuple[int, FloatArray, FloatArray]]:
    """Yield the number of the first block, the blocks and the states at their starts."""
    for begin in range(0, len(blocks), BATCH):
        batch = blocks[begin : begin + BATCH]
        yield begin, batch, _states(transposed, batch @ gains, state)


def _block(a: FloatArray, b: FloatArray, c: FloatArray, direct: float, length: int,
           ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the matrices to state and output, the impulse response and a^length transposed.

    They are cached and shared, since one system is often simulated with many inputs. Do not change
    them.
    """
    return _block_of(a.tobytes(), b.tobytes(), c.tobytes(), float(direct), length)


@lru_cache(maxsize=KEPT)
def _block_of(a_bytes: bytes, b_bytes: bytes, c_bytes: bytes, direct: float, length: int,
              ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    b, c = np.frombuffer(b_bytes), np.frombuffer(c_bytes)
    a = np.frombuffer(a_bytes).reshape(b.size, b.size)
    driven, power = _sequence(a, b, length)
    outputs, _ = _sequence(np.ascontiguousarray(a.T), c, length)
    impulse = np.concatenate([[direct], b @ outputs[:, :-1]])
    return (np.ascontiguousarray(driven[:, ::-1].T), outputs, impulse,
            np.ascontiguousarray(power.T))


def _sequence(a: FloatArray, vector: FloatArray, length: int) -> tuple[FloatArray, FloatArray]:
    """Return the columns a^k vector for each k below length, a power of two, and a^length."""
    columns, power = vector[:, None], a
    while columns.shape[1] < length:
        columns, power = np.hstack([columns, power @ columns]), power @ power
    return columns, power


# The order of the sum is free, so that the processor adds several products at once.
@njit(cache=True, nogil=True, fastmath={"reassoc", "nsz"})
def _answer(samples: FloatArray, states: FloatArray, latest_first: FloatArray,
            outputs: FloatArray, at: NDArray[np.intp], output: FloatArray) -> None:
    """Write the output at some samples of whole blocks, from the states at their starts."""
    length = latest_first.size
    for k in range(at.size):
        block, place = divmod(at[k], length)
        answer = 0.0
        for i in range(place + 1):
            answer += samples[block * length + i] * latest_first[length - 1 - place + i]
        for j in range(states.shape[1]):
            answer += states[block, j] * outputs[j, place]
        output[k] = answer


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
