# SPDX-License-Identifier: BSD-3-Clause
"""Kernels of the Preisach hysteresis: the Everett function from tables, wiping out, the inverse.

Positions are voltages in cells from the lower end of the grid. A grid is `(voltage_min_v,
voltage_max_v, cell_width_v)`, a table what `everett_table` returns. The remembered extremes are
laid out as in `preisach.PreisachMemory`.
"""

import numpy as np
from numba import njit

from piezo_common.arrays import FloatArray

Grid = tuple[float, float, float]
Table = tuple[FloatArray, FloatArray, FloatArray]
Past = tuple[FloatArray, FloatArray, FloatArray, int]
"""What a simulation or an inversion returns: its result, and the memory to go on from."""


def everett_table(density: FloatArray, reversible: FloatArray, cell_width: float) -> Table:
    """Return tables that give the Everett function inside any cell in closed form.

    Returns
    -------
    cells : (L, L, 4) array
        For cell (i, j) with i > j: the Everett function at (level i, level j + 1); integral of the
        full squares of row i between the columns j and i; the same of column j between the rows;
        integral of the square itself.
    diagonal : (L,) array
        Integrals of the triangles on the diagonal.
    reversible : (L,) array
        Integrals along the cells of the diagonal.
    """
    size = density.shape[0]
    squares = np.tril(density, -1) * cell_width**2
    diagonal = np.diagonal(density) * cell_width**2 / 2
    reversible = reversible * cell_width
    integrals = squares + np.diag(diagonal + reversible)
    rows = np.cumsum(integrals[:, ::-1], axis=1)[:, ::-1]
    everett = np.zeros((size + 1, size + 1))
    everett[1:, :-1] = np.cumsum(rows, axis=0)
    cells = np.zeros((size, size, 4))
    cells[:, :, 0] = everett[:-1, 1:]
    cells[:, :-1, 1] = np.cumsum(squares[:, ::-1], axis=1)[:, ::-1][:, 1:]
    cells[1:, :, 2] = np.cumsum(squares, axis=0)[:-1]
    cells[:, :, 3] = squares
    return cells, diagonal, reversible


@njit(cache=True)
def cell_of(position: float, size: int) -> int:
    """Return the index of the cell in which a position lies; the last one has its upper end."""
    return min(int(position), size - 1)


@njit(cache=True)
def _everett(alpha: float, beta: float, cells: FloatArray, diagonal: FloatArray,
             reversible: FloatArray) -> float:
    """Return the Everett function at two positions, in cells from voltage_min_v; alpha >= beta."""
    size = diagonal.size
    i = cell_of(alpha, size)
    j = cell_of(beta, size)
    if i == j:
        return (alpha - beta) * (reversible[i] + (alpha - beta) * diagonal[i])
    x = alpha - i
    y = j + 1 - beta
    return (
        cells[i, j, 0]
        + x * (cells[i, j, 1] + reversible[i] + x * diagonal[i] + y * cells[i, j, 3])
        + y * (cells[i, j, 2] + reversible[j] + y * diagonal[j])
    )


@njit(cache=True)
def everett_values(alpha_v: FloatArray, beta_v: FloatArray, grid: Grid,
                   table: Table) -> FloatArray:
    """Return the Everett function at pairs of voltages.

    Parameters
    ----------
    alpha_v, beta_v : (N,) array
        Within the grid.
    grid, table : tuple

    Returns
    -------
    (N,) array
        In um; zero where `alpha_v` <= `beta_v`.
    """
    voltage_min, _, cell_width = grid
    cells, diagonal, reversible = table
    values = np.zeros(alpha_v.size)
    for n in range(alpha_v.size):
        if alpha_v[n] > beta_v[n]:
            alpha = (alpha_v[n] - voltage_min) / cell_width
            beta = (beta_v[n] - voltage_min) / cell_width
            values[n] = _everett(alpha, beta, cells, diagonal, reversible)
    return values


@njit(cache=True)
def branch_start(extremes: FloatArray, top: int, value: float) -> int:
    """Return the index of the extreme from which the branch to `value` starts; -1 if none is left.

    `value` differs from the present point `extremes[top]` and is not below `extremes[0]`.
    """
    if value > extremes[top]:
        if top % 2 == 1:
            top -= 1
        while top >= 2 and value >= extremes[top - 1]:
            top -= 2
    else:
        if top % 2 == 0:
            top -= 1
        while top >= 1 and value <= extremes[top - 1]:
            top -= 2
    return top


@njit(cache=True)
def with_room(stack: FloatArray, top: int) -> FloatArray:
    """Return the stack itself, or a longer copy if `top` does not fit into it."""
    if top < stack.size:
        return stack
    longer = np.empty(2 * stack.size)
    longer[: stack.size] = stack
    return longer


@njit(cache=True)
def simulate(voltage_v: FloatArray, extremes: FloatArray, outputs: FloatArray, top: int,
             grid: Grid, table: Table) -> Past:
    """Return the hysteresis output for voltages that continue a remembered past.

    Parameters
    ----------
    voltage_v : (N,) array
    extremes, outputs : array
        Of the memory; changed in place, and left for longer ones where they are full.
    top : int
    grid, table : tuple

    Returns
    -------
    (N,) array
        Output in um.
    extremes, outputs : array
    top : int
    """
    voltage_min, voltage_max, cell_width = grid
    cells, diagonal, reversible = table
    output = np.empty(voltage_v.size)
    scale = 1.0 / cell_width
    for n in range(voltage_v.size):
        v = min(max(voltage_v[n], voltage_min), voltage_max)
        if v != extremes[top]:
            start = branch_start(extremes, top, v)
            top = start + 1
            if top == extremes.size:
                extremes, outputs = with_room(extremes, top), with_room(outputs, top)
            extremes[top] = v
            if start >= 0:
                here = (v - voltage_min) * scale
                there = (extremes[start] - voltage_min) * scale
                high, low = max(here, there), min(here, there)
                change = _everett(high, low, cells, diagonal, reversible)
                outputs[top] = outputs[start] + (change if top % 2 == 1 else -change)
        output[n] = outputs[top]
    return output, extremes, outputs, top


@njit(cache=True)
def _root(quadratic: float, linear: float, value: float) -> float:
    """Root of quadratic x^2 + linear x = value in [0, 1]; all non-negative, so nothing cancels."""
    denominator = linear + np.sqrt(linear * linear + 4.0 * quadratic * value)
    if denominator <= 0.0:
        return 0.0
    return min(2.0 * value / denominator, 1.0)


@njit(cache=True)
def _rise(target: float, rounding: float, beta: float, cells: FloatArray,
          diagonal: FloatArray, reversible: FloatArray) -> float:
    """Return the lowest position alpha, in cells, at which Everett from `beta` is `target`.

    No flat stretch is crossed for a rest within `rounding`.
    """
    size = diagonal.size
    j = cell_of(beta, size)
    y = j + 1 - beta
    corner = y * (reversible[j] + diagonal[j] * y)
    if target <= corner + rounding:
        return beta + _root(diagonal[j], reversible[j], min(max(target, 0.0), corner))
    if j == size - 1:
        return float(size)
    low, high = j + 1, size - 1
    while low < high:
        middle = (low + high + 1) // 2
        if cells[middle, j, 0] + y * cells[middle, j, 2] + corner < target - rounding:
            low = middle
        else:
            high = middle - 1
    rest = max(target - (cells[low, j, 0] + y * cells[low, j, 2] + corner), 0.0)
    slope = cells[low, j, 1] + reversible[low] + y * cells[low, j, 3]
    return low + _root(diagonal[low], slope, rest)


@njit(cache=True)
def _fall(target: float, rounding: float, alpha: float, cells: FloatArray,
          diagonal: FloatArray, reversible: FloatArray) -> float:
    """Return highest position beta, in cells, at which the Everett function to `alpha` is `target`.

    No flat stretch is crossed for a rest within `rounding`.
    """
    size = diagonal.size
    i = cell_of(alpha, size)
    x = alpha - i
    corner = x * (reversible[i] + diagonal[i] * x)
    if target <= corner + rounding:
        return alpha - _root(diagonal[i], reversible[i], min(max(target, 0.0), corner))
    if i == 0:
        return 0.0
    low, high = 0, i - 1
    while low < high:
        middle = (low + high) // 2
        if cells[i, middle, 0] + x * cells[i, middle, 1] + corner < target - rounding:
            high = middle
        else:
            low = middle + 1
    rest = max(target - (cells[i, low, 0] + x * cells[i, low, 1] + corner), 0.0)
    slope = cells[i, low, 2] + reversible[low] + x * cells[i, low, 3]
    return low + 1 - _root(diagonal[low], slope, rest)


@njit(cache=True)
def invert(target_um: FloatArray, rounding_um: float, extremes: FloatArray,
           outputs: FloatArray, top: int, grid: Grid, table: Table) -> Past:
    """Return the voltages that bring the output to each target, from a remembered past on.

    Parameters
    ----------
    target_um : (N,) array
        Within the output range.
    rounding_um : float
        No flat stretch is crossed for a rest within it.
    extremes, outputs : array
        Of the memory; changed in place, and left for longer ones where they are full.
    top : int
    grid, table : tuple

    Returns
    -------
    (N,) array
        Voltage in V.
    extremes, outputs : array
    top : int
    """
    voltage_min, voltage_max, cell_width = grid
    cells, diagonal, reversible = table
    voltage = np.empty(target_um.size)
    scale = 1.0 / cell_width
    for n in range(target_um.size):
        goal = target_um[n]
        v = extremes[top]
        if goal > outputs[top]:
            if top % 2 == 1:
                top -= 1
            while top >= 2 and goal > outputs[top - 1]:
                v = extremes[top - 1]
                top -= 2
            if top >= 2 and goal == outputs[top - 1]:
                v = extremes[top - 1]
                top -= 2
            else:
                beta = (extremes[top] - voltage_min) * scale
                alpha = _rise(goal - outputs[top], rounding_um, beta, cells, diagonal, reversible)
                ceiling = extremes[top - 1] if top >= 2 else voltage_max
                v = min(max(voltage_min + alpha * cell_width, v), ceiling)
            top += 1
        elif goal < outputs[top]:
            if top % 2 == 0:
                top -= 1
            while top >= 3 and goal < outputs[top - 1]:
                v = extremes[top - 1]
                top -= 2
            if top >= 3 and goal == outputs[top - 1]:
                v = extremes[top - 1]
                top -= 2
            else:
                alpha = (extremes[top] - voltage_min) * scale
                beta = _fall(outputs[top] - goal, rounding_um, alpha, cells, diagonal, reversible)
                v = max(min(voltage_min + beta * cell_width, v), extremes[top - 1])
            top += 1
        if top == extremes.size:
            extremes, outputs = with_room(extremes, top), with_room(outputs, top)
        extremes[top] = v
        # The target itself is stored, so that a target that stays leaves the voltage where it is.
        outputs[top] = goal
        voltage[n] = v
    return voltage, extremes, outputs, top
