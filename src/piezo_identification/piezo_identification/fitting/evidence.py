# SPDX-License-Identifier: BSD-3-Clause
"""The evidence that compares any two models of the same recordings."""

import numpy as np
from numpy.typing import ArrayLike

from piezo_common.arrays import FloatArray

INDEPENDENT = 1000.0
"""Errors of each recording that count at most, however many rows it has."""

FEWEST = 0.25
"""Part of the rows whose errors count at least: those that are alike for long may hide smaller ones
that are not."""

BLOCKS, FEWEST_BLOCKS = (10, 100, 1000), 10
"""Neighbouring rows whose means tell how far errors are alike, and blocks for them to tell it."""


def correlated_scale(residual: FloatArray) -> float:
    """Return the RMS of a residual, times the root of how many neighbours err alike.

    Parameters
    ----------
    residual : (N,) array

    Returns
    -------
    float
        Of white noise its standard deviation. The variance of a mean over a long block is that of
        white noise of this standard deviation, over the length of the block.
    """
    squares = [np.mean(residual**2)]
    for length in BLOCKS:
        blocks = residual[: residual.size // length * length].reshape(-1, length)
        if len(blocks) >= FEWEST_BLOCKS:
            squares.append(length * np.mean(blocks.mean(axis=1) ** 2))
    return float(np.sqrt(max(squares)))


def independent_errors(residual: FloatArray) -> float:
    """Return how many errors of a residual, shape (N,), are independent, within what may count."""
    scale = max(correlated_scale(residual), np.finfo(float).tiny)
    count = np.sum((residual / scale) ** 2)
    return float(np.clip(count, FEWEST * residual.size, INDEPENDENT))


def log_evidence(mean_squares: ArrayLike, numbers: int,
                 independent: ArrayLike = INDEPENDENT) -> float:
    """Return the logarithm of the evidence of a model but for what all models have in common.

    That is the logarithm of its likelihood, less half the logarithm of the number of errors for
    each number that was estimated (Schwarz 1978).

    Parameters
    ----------
    mean_squares : float or ndarray, shape (R,)
        What the model leaves of each recording, and the square of the accuracy of a good model.
    numbers : int
        Numbers that were estimated.
    independent : float or ndarray, shape (R,)
        Errors that count of each recording.
    """
    squares = np.atleast_1d(mean_squares)
    counts = np.broadcast_to(independent, squares.shape)
    return float(-0.5 * counts @ np.log(squares) - 0.5 * numbers * np.log(counts.sum()))
