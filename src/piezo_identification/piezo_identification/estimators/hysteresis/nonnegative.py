# SPDX-License-Identifier: BSD-3-Clause
"""Sparse quadratic minimisation with linear bounds, for a non-negative density."""

from collections.abc import Callable

import numpy as np
from scipy.sparse import csc_array, csr_array
from scipy.sparse.linalg import SuperLU, splu

from piezo_common.arrays import BoolArray, FloatArray
from piezo_common.cancellation import check_cancelled

PENALTY = 100.0
"""Penalty of a violated bound, relative to the mean curvature of the quadratic form."""

VIOLATION, ROUGH_VIOLATION = 1e-5, 1e-3
"""Sum of values below zero, relative to the sum of magnitudes, that counts as zero; for a rough
minimum, too."""

UNDECIDED, ROUGHLY_UNDECIDED = 1e-3, 1e-2
"""Share of bounds that change in a step below which the rest does not matter; for a rough minimum,
too."""

BISECTIONS = 10
"""Number of bisections that determine the length of a step."""

PANEL = 10
"""Number of columns factorised together: of 4 to 40, the fastest on 70 cells."""

MOST_FACTORISATIONS = 60
"""Limit of the search for the active bounds; 1 to 20 factorisations are usual."""


def nonnegative_minimum(
    quadratic: csr_array, linear: FloatArray, bounded: csr_array, border: FloatArray,
    corner: FloatArray, border_linear: FloatArray, multiplier: FloatArray | None = None,
    is_rough: bool = False,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Minimise x H x / 2 - c x over x = (e, z) with T e >= 0, sparse in e, with a few z.

    Augmented Lagrangian method. Each of its piecewise quadratic functions is minimised by Newton
    steps: exact after a few factorisations, and after one if no bound is active.

    Parameters
    ----------
    quadratic : sparse array, shape (n, n)
        Quadratic form of e; positive definite.
    linear : ndarray, shape (n,)
    bounded : sparse array, shape (m, n)
        T.
    border : ndarray, shape (n, k)
        Quadratic form between e and z.
    corner : ndarray, shape (k, k)
        Quadratic form of z.
    border_linear : ndarray, shape (k,)
    multiplier : ndarray, shape (m,), optional
        Initial multipliers of the bounds, which save factorisations.
    is_rough : bool
        True for a minimum with about half of the factorisations, to compare penalties.

    Returns
    -------
    ndarray, shape (n,)
        e; `bounded @ e` may be below zero by `VIOLATION` or `ROUGH_VIOLATION`.
    ndarray, shape (k,)
        z.
    ndarray, shape (m,)
        Multipliers of the bounds.
    """
    bounded = bounded.tocsr()
    violation, undecided = ((ROUGH_VIOLATION, ROUGHLY_UNDECIDED) if is_rough
                            else (VIOLATION, UNDECIDED))
    penalty = PENALTY * quadratic.diagonal().mean()
    forces = np.zeros(bounded.shape[0]) if multiplier is None else multiplier

    def newton_point(active: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Minimum of the function that is quadratic while exactly these bounds are violated."""
        rows = bounded[active]
        factor = _factor(quadratic + penalty * (rows.T @ rows))
        right_sides = np.column_stack([linear + rows.T @ forces[active], border])
        solved = factor.solve(right_sides)
        free = np.linalg.lstsq(
            corner - border.T @ solved[:, 1:], border_linear - border.T @ solved[:, 0], rcond=1e-13
        )[0]
        return solved[:, 0] - solved[:, 1:] @ free, free

    def slope_along(step: FloatArray,
                    step_free: FloatArray) -> Callable[[float], float]:
        """Return the slope of the function along a step from the point, by the length."""
        moved = bounded @ step
        start = (quadratic @ point + border @ free - linear) @ step + (
            border.T @ point + corner @ free - border_linear) @ step_free
        bend = (quadratic @ step + border @ step_free) @ step + (
            border.T @ step + corner @ step_free) @ step_free
        return lambda length: float(start + length * bend - np.maximum(
            forces - penalty * (values + length * moved), 0.0) @ moved)

    active = forces > 0.0
    point, free = newton_point(active)
    for _ in range(MOST_FACTORISATIONS):
        check_cancelled()
        values = bounded @ point
        violated = forces - penalty * values > 0.0
        if np.count_nonzero(violated != active) <= undecided * active.size:
            if -np.minimum(values, 0.0).sum() <= violation * np.abs(values).sum():
                break
            forces = np.maximum(forces - penalty * values, 0.0)
            violated = forces > 0.0
        active = violated
        target, target_free = newton_point(active)
        step, step_free = target - point, target_free - free
        length = _length(slope_along(step, step_free))
        point, free = point + length * step, free + length * step_free
    return point, free, np.maximum(forces - penalty * (bounded @ point), 0.0)


def _length(slope: Callable[[float], float]) -> float:
    """Fraction of a step that minimises a convex function, from its increasing slope."""
    if slope(1.0) <= 0.0:
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if slope(middle) < 0.0 else (low, middle)
    return high


def _factor(matrix: csr_array) -> SuperLU:
    return splu(
        csc_array(matrix), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, panel_size=PANEL,
        options={"SymmetricMode": True},
    )
