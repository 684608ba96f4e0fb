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
"""Systems whose matrices are cached, 0.1 MB for each output; a fit simulates many inputs of a few
systems at a time."""

LONG = 128
"""Samples of a block if few outputs are needed, which makes the states the main cost."""

MANY = 0.4
"""Share of the samples above which all are computed, as products of matrices, instead of some."""


def run_blocks(a: FloatArray, b: FloatArray, c: FloatArray, direct: float, samples: FloatArray,
               state: FloatArray, output: FloatArray) -> int:
    """Simulate all whole blocks, and return their number of samples, a multiple of `LENGTH`.

    The system is x[k + 1] = a x[k] + b v[k], y[k] = c x[k] + direct v[k]. The state at the first
    sample is updated in place to that after the last block; the output is filled with that of the
    blocks.
    """
    gains, outputs, impulse, transposed = _block(a, b, c[None], np.array([direct]), LENGTH)
    of_states = np.ascontiguousarray(outputs[0].T)
    answers = np.ascontiguousarray(
        sliding_window_view(np.concatenate([np.zeros(LENGTH - 1), impulse[0]]), LENGTH)[::-1])
    done = samples.size // LENGTH * LENGTH
    blocks, behind = (each[:done].reshape(-1, LENGTH) for each in (samples, output))
    for begin in range(0, len(blocks), BATCH):
        batch = blocks[begin : begin + BATCH]
        states = _states(transposed, batch @ gains, state)
        np.matmul(batch, answers, out=behind[begin : begin + BATCH])
        behind[begin : begin + BATCH] += states @ of_states
    return done


def outputs_in_blocks(a: FloatArray, b: FloatArray, c: FloatArray, direct: FloatArray,
                      samples: FloatArray, state: FloatArray,
                      at: NDArray[np.intp]) -> FloatArray:
    """Return the outputs of a system with several outputs at a few samples, sorted, (m, outputs).

    For other samples, only the states at the starts of blocks of `LONG` samples are computed, once
    for all outputs. `c` is (outputs, n), `direct` is (outputs,); the state at the first sample is
    overwritten.
    """
    if at.size >= FEWEST and at.size > MANY * samples.size:
        # The outputs do not depend on the samples after them.
        padded = np.concatenate([samples, np.zeros(-samples.size % LENGTH)])
        every = np.empty((len(c), padded.size))
        for own, own_direct, output in zip(c, direct, every, strict=True):
            run_blocks(a, b, own, own_direct, padded, state.copy(), output)
        return np.ascontiguousarray(every.T[at])
    gains, outputs, impulse, transposed = _block(a, b, c, direct, LONG)
    answers, latest_first = np.empty((at.size, len(c))), np.ascontiguousarray(impulse[:, ::-1])
    last = at[-1] + 1 if at.size else 0
    for begin in range(0, last, BATCH * LONG):
        batch = samples[begin : begin + BATCH * LONG]
        whole = batch.size // LONG * LONG
        states = _states(transposed, batch[:whole].reshape(-1, LONG) @ gains, state)
        asked = slice(*np.searchsorted(at, [begin, begin + BATCH * LONG]))
        _answer(batch, np.vstack([states, state]), latest_first, outputs, at[asked] - begin,
                answers[asked])
    return answers


def _block(a: FloatArray, b: FloatArray, c: FloatArray, direct: FloatArray, length: int,
           ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the matrices to state and outputs, the impulse responses and a^length transposed.

    They are cached and shared, since one system is often simulated with many inputs. Do not change
    them.
    """
    return _block_of(a.tobytes(), b.tobytes(), c.tobytes(), direct.tobytes(), length)


@lru_cache(maxsize=KEPT)
def _block_of(a_bytes: bytes, b_bytes: bytes, c_bytes: bytes, direct_bytes: bytes, length: int,
              ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    b, direct = np.frombuffer(b_bytes), np.frombuffer(direct_bytes)
    a, c = np.frombuffer(a_bytes).reshape(-1, b.size), np.frombuffer(c_bytes).reshape(-1, b.size)
    driven, transposed = _sequence(b[None], np.ascontiguousarray(a.T), length)
    outputs = np.ascontiguousarray(_sequence(c, a, length)[0].swapaxes(0, 1))
    impulse = np.column_stack([direct, outputs[:, :-1] @ b])
    return np.ascontiguousarray(driven[::-1, 0]), outputs, impulse, transposed


def _sequence(rows: FloatArray, a: FloatArray, length: int) -> tuple[FloatArray, FloatArray]:
    """Return rows a^k for each k below length, a power of two, (length, rows, n), and a^length."""
    sequence, power = rows[None], a
    while len(sequence) < length:
        sequence, power = np.concatenate([sequence, sequence @ power]), power @ power
    return sequence, power


# The order of the sum is free, so that the processor adds several products at once.
@njit(cache=True, nogil=True, fastmath={"reassoc", "nsz"})
def _answer(samples: FloatArray, states: FloatArray, latest_first: FloatArray,
            outputs: FloatArray, at: NDArray[np.intp], answers: FloatArray) -> None:
    """Write the outputs at some samples of blocks, from the states at the starts of these."""
    count, length = latest_first.shape
    for k in range(at.size):
        block, place = divmod(at[k], length)
        for number in range(count):
            answer = 0.0
            for i in range(place + 1):
                answer += samples[block * length + i] * latest_first[
                    number, length - 1 - place + i]
            for j in range(states.shape[1]):
                answer += states[block, j] * outputs[number, place, j]
            answers[k, number] = answer


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
