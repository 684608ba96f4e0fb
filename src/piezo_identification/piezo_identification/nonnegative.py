# SPDX-License-Identifier: BSD-3-Clause
"""Non-negative least squares on normal equations, by block principal pivoting."""

import numpy as np
from scipy.linalg import cho_factor, cho_solve

PATIENCE = 5
"""Exchanges of whole blocks without progress before single exchanges, which cannot cycle."""


def nonnegative_minimum(quadratic, linear, free=0):
    """Minimise x Q x / 2 - c x with x >= 0, by block principal pivoting (Judice and Pires 1994).

    Starts from the unconstrained minimum: where few bounds hold, as for a smoothed density, a few
    factorisations are enough.

    Parameters
    ----------
    quadratic : ndarray, shape (n, n)
        Q, symmetric and positive definite.
    linear : ndarray, shape (n,)
        c.
    free : int
        The last so many variables may be negative.

    Returns
    -------
    ndarray, shape (n,)
    """
    size = linear.size
    passive = np.ones(size, dtype=bool)
    bounded = np.arange(size) < size - free
    fewest, patience = size + 1, PATIENCE
    tolerance = 1e-12 * np.abs(linear).max()
    while True:
        solution = np.zeros(size)
        factor = cho_factor(quadratic[np.ix_(passive, passive)], check_finite=False)
        solution[passive] = cho_solve(factor, linear[passive], check_finite=False)
        gradient = quadratic @ solution - linear
        wrong = bounded & np.where(passive, solution < 0.0, gradient < -tolerance)
        count = np.count_nonzero(wrong)
        if count == 0:
            return solution
        if count < fewest:
            fewest, patience = count, PATIENCE
        elif patience > 0:
            patience -= 1
        else:
            wrong = np.arange(size) == np.flatnonzero(wrong)[-1]
        passive ^= wrong
