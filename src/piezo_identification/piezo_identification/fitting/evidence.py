# SPDX-License-Identifier: BSD-3-Clause
"""The evidence that compares any two models of the same recordings."""

import numpy as np
from numpy.typing import ArrayLike

INDEPENDENT = 1000.0
"""Errors of each recording that count, as many in all fits and however many rows it has:
neighbouring errors are alike."""


def log_evidence(mean_squares: ArrayLike, numbers: int, independent: float = INDEPENDENT) -> float:
    """Return the logarithm of the evidence of a model but for what all models have in common.

    That is the logarithm of its likelihood, less half the logarithm of the number of errors for
    each number that was estimated (Schwarz 1978).

    Parameters
    ----------
    mean_squares : float or ndarray, shape (R,)
        What the model leaves of each recording, and the square of the accuracy of a good model.
    numbers : int
        Numbers that were estimated.
    independent : float
        Errors that count of each recording.
    """
    squares = np.atleast_1d(mean_squares)
    return float(-0.5 * independent * np.log(squares).sum()
                 - 0.5 * numbers * np.log(independent * squares.size))
