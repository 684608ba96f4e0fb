# SPDX-License-Identifier: BSD-3-Clause
"""The evidence that compares any two models of the same recordings."""

import numpy as np
from numpy.typing import ArrayLike

from piezo_common.arrays import FloatArray

INDEPENDENT = 1000.0
"""Largest number of independent errors counted per recording, however many rows it has."""

FEWEST = 0.25
"""Smallest share of the rows that counts as independent: strongly correlated errors may hide
smaller uncorrelated ones."""

BLOCKS, FEWEST_BLOCKS = (10, 100, 1000), 10
"""Block lengths, in rows, whose means show the correlation of errors; fewest blocks needed."""


def correlated_scale(residual: FloatArray) -> float:
    """Return the RMS of a residual, (N,), increased to account for correlation of neighbours.

    For white noise, it is the standard deviation. Otherwise, it is that of the white noise whose
    means over long blocks would vary as much as those of the residual.
    """
    squares = [np.mean(residual**2)]
    for length in BLOCKS:
        blocks = residual[: residual.size // length * length].reshape(-1, length)
        if len(blocks) >= FEWEST_BLOCKS:
            squares.append(length * np.mean(blocks.mean(axis=1) ** 2))
    return float(np.sqrt(max(squares)))


def independent_errors(residual: FloatArray) -> float:
    """Return the number of independent errors in a residual, shape (N,), limited to what counts."""
    scale = max(correlated_scale(residual), np.finfo(float).tiny)
    count = np.sum((residual / scale) ** 2)
    return float(np.clip(count, FEWEST * residual.size, INDEPENDENT))


def log_evidence(mean_squares: ArrayLike, numbers: int,
                 independent: ArrayLike = INDEPENDENT) -> float:
    """Return the logarithm of the evidence of a model, up to a constant common to all models.

    It is the log-likelihood minus half the logarithm of the number of errors for each estimated
    parameter (Schwarz 1978). `mean_squares` is the mean square error of the model on each
    recording, plus the squared accuracy of a good model, and `independent` the number of
    independent errors counted in each. Both are one number or (R,). `numbers` is the number of
    estimated parameters.
    """
    squares = np.atleast_1d(mean_squares)
    counts = np.broadcast_to(independent, squares.shape)
    return float(-0.5 * counts @ np.log(squares) - 0.5 * numbers * np.log(counts.sum()))
