# SPDX-License-Identifier: BSD-3-Clause
"""Kernels of the Preisach hysteresis: the Everett function from tables, and wiping-out.

Positions are voltages in cells from the lower end of the grid. A grid is `(voltage_min_v,
voltage_max_v, cell_width_v)`, a table is the result of `everett_table`. The stored extremes have
the layout of `preisach.PreisachMemory`.
"""

import numpy as np
from numba import njit

from piezo_common.arrays import FloatArray

Grid = tuple[float, float, float]
Table = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
Past = tuple[FloatArray, FloatArray, FloatArray, int]
"""Result of a simulation or an inversion: the signal, and the memory after it."""


def everett_table(density: FloatArray, reversible: FloatArray, cell_width: float) -> Table:
    """Return tables that give the Everett function inside any cell in closed form.

    The columns and the rows, (L + 1, L + 1), hold it at pairs of levels: `columns[j, i]` is
    `rows[i, j]`, that of level i over level j. On a branch one level is fixed, so its values are
    adjacent in one of them. Between the levels, off the diagonal, the function is bilinear minus x
    (1 - x) times the triangle of each of its two voltages, where x is the position of the voltage
    in its cell. The third table, (L,), holds the integrals of the triangles on the diagonal, the
    last, (L,), those of the reversible part along its cells.
    """
    diagonal = np.diagonal(density) * cell_width**2 / 2
    reversible = reversible * cell_width
    rows = _everett_at_levels(density, cell_width**2, diagonal + reversible)
    return rows.T.copy(), rows, diagonal, reversible


@njit(cache=True)
def _everett_at_levels(density: FloatArray, cell_area: float, diagonal: FloatArray) -> FloatArray:
    """Return the Everett function at pairs of levels, given the integrals of the diagonal cells."""
    size = diagonal.size
    rows = np.zeros((size + 1, size + 1))
    for i in range(size):
        of_row = diagonal[i]
        rows[i + 1, i] = of_row
        for j in range(i - 1, -1, -1):
            of_row += density[i, j] * cell_area
            rows[i + 1, j] = rows[i, j] + of_row
    return rows


@njit(cache=True)
def cell_of(position: float, size: int) -> int:
    """Return the index of the cell of a position; the last cell includes its upper end."""
    return min(int(position), size - 1)


@njit(cache=True)
def between(near: FloatArray, far: FloatArray, part: float, level: int) -> float:
    """Interpolate the Everett function between two levels of one voltage, at a level of the other.

    If the voltage lies at the fraction x of its cell from `near`, the function is smaller than the
    result by x (1 - x) times the triangle of this cell on the diagonal. `near` and `far` are the
    function at the two levels of the one voltage, over the levels of the other, in um; `part` is
    the fraction of the way between them.
    """
    return near[level] + part * (far[level] - near[level])


@njit(cache=True)
def _everett(alpha: float, beta: float, columns: FloatArray, diagonal: FloatArray,
             reversible: FloatArray) -> float:
    """Return the Everett function at two positions, in cells from voltage_min_v; alpha >= beta."""
    size = diagonal.size
    i = cell_of(alpha, size)
    j = cell_of(beta, size)
    if i == j:
        return (alpha - beta) * (reversible[i] + (alpha - beta) * diagonal[i])
    x = alpha - i
    y = j + 1 - beta
    near, far = columns[j + 1], columns[j]
    below, above = between(near, far, y, i), between(near, far, y, i + 1)
    return (below + x * ((above - below) - (1.0 - x) * diagonal[i])) - y * (1.0 - y) * diagonal[j]


@njit(cache=True)
def everett_values(alpha_v: FloatArray, beta_v: FloatArray, grid: Grid,
                   table: Table) -> FloatArray:
    """Return the Everett function (um) at pairs of voltages within the grid, (N,).

    It is zero if `alpha_v` <= `beta_v`.
    """
    voltage_min, _, cell_width = grid
    columns, _, diagonal, reversible = table
    values = np.zeros(alpha_v.size)
    for n in range(alpha_v.size):
        if alpha_v[n] > beta_v[n]:
            alpha = (alpha_v[n] - voltage_min) / cell_width
            beta = (beta_v[n] - voltage_min) / cell_width
            values[n] = _everett(alpha, beta, columns, diagonal, reversible)
    return values


@njit(cache=True)
def branch_start(extremes: FloatArray, top: int, value: float) -> int:
    """Return the index of the extreme from which the branch to `value` starts; -1 if none remains.

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
def _along_rise(voltage_v: FloatArray, output_um: FloatArray, n: int, beta: float,
               start_um: float, limit_v: float, grid: Grid, table: Table) -> tuple[int, float]:
    """Play voltages from sample `n` on for as long as they rise from one minimum.

    The voltage of sample `n` lies above the minimum, `beta` in cells, and below the stored maximum
    `limit_v`; reaching it wipes the minimum out. Returned are the first sample that falls or
    reaches the limit, and the last voltage in V.
    """
    voltage_min, voltage_max, cell_width = grid
    columns, _, diagonal, reversible = table
    scale = 1.0 / cell_width
    size = diagonal.size
    # The loop has only what depends on alpha; the order of the sums is that of `_everett`.
    j = cell_of(beta, size)
    y = j + 1 - beta
    own_diagonal, own_reversible = diagonal[j], reversible[j]
    corner_um = start_um - y * (1.0 - y) * own_diagonal
    near, far = columns[j + 1], columns[j]
    present = voltage_min
    while n < voltage_v.size:
        v = min(max(voltage_v[n], voltage_min), voltage_max)
        if v < present or v >= limit_v:
            break
        alpha = (v - voltage_min) * scale
        i = cell_of(alpha, size)
        if i == j:
            output_um[n] = start_um + (alpha - beta) * (
                own_reversible + (alpha - beta) * own_diagonal)
        else:
            x = alpha - i
            below, above = between(near, far, y, i), between(near, far, y, i + 1)
            output_um[n] = corner_um + (below + x * ((above - below) - (1.0 - x) * diagonal[i]))
        present = v
        n += 1
    return n, present


@njit(cache=True)
def _along_fall(voltage_v: FloatArray, output_um: FloatArray, n: int, alpha: float,
               start_um: float, limit_v: float, grid: Grid, table: Table) -> tuple[int, float]:
    """Play voltages from sample `n` on for as long as they fall from one maximum.

    `alpha` is the maximum, `limit_v` the stored minimum; all else is as for `_along_rise`.
    """
    voltage_min, voltage_max, cell_width = grid
    _, rows, diagonal, reversible = table
    scale = 1.0 / cell_width
    size = diagonal.size
    i = cell_of(alpha, size)
    x = alpha - i
    own_diagonal, own_reversible = diagonal[i], reversible[i]
    corner_um = start_um + x * (1.0 - x) * own_diagonal
    near, far = rows[i], rows[i + 1]
    present = voltage_max
    while n < voltage_v.size:
        v = min(max(voltage_v[n], voltage_min), voltage_max)
        if v > present or v <= limit_v:
            break
        beta = (v - voltage_min) * scale
        j = cell_of(beta, size)
        if i == j:
            output_um[n] = start_um - (alpha - beta) * (
                own_reversible + (alpha - beta) * own_diagonal)
        else:
            y = j + 1 - beta
            below, above = between(near, far, x, j), between(near, far, x, j + 1)
            output_um[n] = corner_um - (above + y * ((below - above) - (1.0 - y) * diagonal[j]))
        present = v
        n += 1
    return n, present


@njit(cache=True)
def simulate_while_room(voltage_v: FloatArray, output_um: FloatArray, n: int,
                        extremes: FloatArray, outputs: FloatArray, top: int, grid: Grid,
                        table: Table) -> tuple[int, int]:
    """Write the output from sample `n` on, without allocation, until the memory is full.

    The stacks of the memory are changed in place. Returned are N, or the sample whose reversal does
    not fit into the memory, and the index of the present point in the stacks.
    """
    voltage_min, voltage_max, cell_width = grid
    scale = 1.0 / cell_width
    while n < voltage_v.size:
        v = min(max(voltage_v[n], voltage_min), voltage_max)
        if v == extremes[top]:
            output_um[n] = outputs[top]
            n += 1
            continue
        start = branch_start(extremes, top, v)
        if start < 0:
            top, extremes[0] = 0, v
            continue
        if start + 1 == extremes.size:
            break
        top = start + 1
        turn = (extremes[start] - voltage_min) * scale
        if top % 2 == 1:
            limit_v = extremes[start - 1] if start >= 2 else np.inf
            n, extremes[top] = _along_rise(
                voltage_v, output_um, n, turn, outputs[start], limit_v, grid, table)
        else:
            n, extremes[top] = _along_fall(
                voltage_v, output_um, n, turn, outputs[start], extremes[start - 1], grid, table)
        outputs[top] = output_um[n - 1]
    return n, top


@njit(cache=True, nogil=True)
def simulate(voltage_v: FloatArray, extremes: FloatArray, outputs: FloatArray, top: int,
             grid: Grid, table: Table) -> Past:
    """Return the hysteresis output (um) for voltages, (N,), that continue a stored past.

    It is followed by the stacks of the memory, which are changed in place, or replaced by longer
    ones if they are full, and by their top.
    """
    output = np.empty(voltage_v.size)
    n, top = simulate_while_room(voltage_v, output, 0, extremes, outputs, top, grid, table)
    while n < voltage_v.size:
        extremes = with_room(extremes, extremes.size)
        outputs = with_room(outputs, outputs.size)
        n, top = simulate_while_room(voltage_v, output, n, extremes, outputs, top, grid, table)
    return output, extremes, outputs, top
