# SPDX-License-Identifier: BSD-3-Clause
"""Subspace identification in the predictor form (PBSID)."""

from dataclasses import dataclass

import numpy as np

from piezo_common.arrays import FloatArray


@dataclass(frozen=True)
class Innovations:
    """Discrete system x+ = A x + K e, y = C x + e, without its input."""

    transition: FloatArray
    """Matrix A, (n, n)."""
    innovation_gain: FloatArray
    output_gain: FloatArray
    """Vectors K and C, (n,)."""


def identify_subspace(
    input: FloatArray, output: FloatArray, order: int,
) -> Innovations:
    """Identify a system in innovations form, without initial values or iterations.

    A long autoregression gives the Markov parameters of the predictor. The states are the singular
    vectors of the future output predicted from the past, and two regressions give the matrices
    (Chiuso, "The role of vector autoregressive modeling in predictor-based subspace
    identification", 2007).

    Parameters
    ----------
    input, output : ndarray, shape (N,)
        Signals without offset; the output responds after one sample at the earliest.
    order : int
        Number of states.

    Raises
    ------
    ValueError
        If the record is too short for the order.
    """
    past = max(40, 4 * order)  # rows of the autoregression
    rows = output.size - past
    if past <= order or rows < 6 * past:
        raise ValueError(
            f"{output.size} samples are too few for a subspace of order {order}: record longer"
        )

    def lags(signal: FloatArray) -> FloatArray:
        # Column j holds the signal j + 1 samples ago.
        return np.lib.stride_tricks.sliding_window_view(signal[:-1], past)[:, ::-1]

    history = np.hstack([lags(output), lags(input)])
    orthogonal, triangle = np.linalg.qr(history)
    target = output[past:]
    markov = np.linalg.lstsq(triangle, orthogonal.T @ target, rcond=1e-12)[0].reshape(2, past)
    # Row i predicts i samples further ahead from the same past.
    future = min(past, max(20, 3 * order))
    predictors = np.zeros((future, 2, past))
    for i in range(future):
        predictors[i, :, : past - i] = markov[:, i:]
    observed = predictors.reshape(future, 2 * past) @ triangle.T
    states = np.linalg.svd(observed, full_matrices=False)[2][:order]
    states = states @ orthogonal.T * np.sqrt(rows)
    output_gain = np.linalg.lstsq(states.T, target, rcond=None)[0]
    innovation = target - output_gain @ states
    present = np.column_stack([states[:, :-1].T, input[past:-1], innovation[:-1]])
    step = np.linalg.lstsq(present, states[:, 1:].T, rcond=None)[0].T
    return Innovations(step[:, :order], step[:, order + 1], output_gain)
