# SPDX-License-Identifier: BSD-3-Clause
"""Kernels of the inverse Preisach hysteresis: voltages from outputs, branch by branch.

On a branch one argument of the Everett function is fixed, and the cell of the other moves in one
direction only. The search for a target therefore starts from the cell of the last one, first at
the distance of the last step, and a quadratic is solved in the cell that is found. This guess needs
no table and no division, so that the processor can execute several targets ahead. The search is
inlined into the loop (`inline`), since a call for each target costs as much as the search.
"""

import numpy as np
from numba import njit

from piezo_common.arrays import FloatArray
from piezo_models.hysteresis.preisach_kernels import (
    Grid,
    Past,
    Table,
    between,
    cell_of,
    with_room,
)


@njit(cache=True)
def _root(quadratic: float, linear: float, value: float) -> float:
    """Root of quadratic x^2 + linear x = value in [0, 1]; no cancellation, as all are >= 0."""
    denominator = linear + np.sqrt(linear * linear + 4.0 * quadratic * value)
    if denominator <= 0.0:
        return 0.0
    return min(2.0 * value / denominator, 1.0)


@njit(cache=True, inline="always")
def _last_row_below(near: FloatArray, far: FloatArray, y: float, goal: float, i: int,
                    guess: int) -> int:
    """Return the last row from i on at whose lower edge the function is below `goal`, or i.

    The search starts at `guess`, continues at growing distances from there, and ends by bisection.
    """
    last = near.size - 2
    step = 1
    if between(near, far, y, guess) < goal:
        low = guess
        while low + step <= last and between(near, far, y, low + step) < goal:
            low += step
            step *= 2
        high = min(low + step - 1, last)
    else:
        low, high = i, max(guess - 1, i)
        while high - step >= low and between(near, far, y, high - step + 1) >= goal:
            high -= step
            step *= 2
        low = max(high - step + 1, low)
    while low < high:
        middle = (low + high + 1) // 2
        if between(near, far, y, middle) < goal:
            low = middle
        else:
            high = middle - 1
    return low


@njit(cache=True, inline="always")
def _first_column_below(near: FloatArray, far: FloatArray, x: float, goal: float, j: int,
                        guess: int) -> int:
    """Return the first column, down from j, at whose upper edge it is below `goal`, or j."""
    step = 1
    if between(near, far, x, guess + 1) < goal:
        high = guess
        while high - step >= 0 and between(near, far, x, high - step + 1) < goal:
            high -= step
            step *= 2
        low = max(high - step + 1, 0)
    else:
        low, high = min(guess + 1, j), j
        while low + step <= high and between(near, far, x, low + step) >= goal:
            low += step
            step *= 2
        high = min(low + step - 1, high)
    while low < high:
        middle = (low + high) // 2
        if between(near, far, x, middle + 1) < goal:
            high = middle
        else:
            low = middle + 1
    return high


@njit(cache=True)
def _along_rise(target_um: FloatArray, voltage_v: FloatArray, n: int, v: float, start_v: float,
                start_um: float, limit_v: float, limit_um: float, rounding_um: float,
                grid: Grid, table: Table) -> tuple[int, float]:
    """Invert targets from sample `n` on for as long as they rise from one minimum.

    The target of sample `n` lies above the minimum's output and below `limit_um`, the output of the
    stored maximum; reaching it wipes the minimum out. The voltage does not fall below the present
    one, `v`. No flat stretch is crossed for a remainder below `rounding_um`. Returned are the first
    sample that falls or reaches the limit, and the last voltage in V.
    """
    voltage_min, _, cell_width = grid
    columns, _, diagonal, reversible = table
    size = diagonal.size
    beta = (start_v - voltage_min) * (1.0 / cell_width)
    j = cell_of(beta, size)
    y = j + 1 - beta
    own_diagonal, own_reversible = diagonal[j], reversible[j]
    corner = y * (own_reversible + own_diagonal * y)
    near, far = columns[j + 1], columns[j]
    # Distance of the function below the straight line between these two.
    dip = y * (1.0 - y) * own_diagonal
    i, step = j + 1, 0
    curve = slope = below = 0.0
    # The function at the lower and the upper edge of row i; -inf before the first search.
    above = -np.inf
    present = start_um
    while n < target_um.size:
        goal = target_um[n]
        if goal < present or goal >= limit_um:
            break
        target = goal - start_um
        if target <= corner + rounding_um:
            alpha = beta + _root(own_diagonal, own_reversible, min(max(target, 0.0), corner))
        elif j == size - 1:
            alpha = float(size)
        else:
            if above < target - rounding_um:
                guess = min(i + step, size - 1)
                found = _last_row_below(near, far, y, target - rounding_um + dip, i, guess)
                step, i = found - i, found
                below = between(near, far, y, i) - dip
                above = between(near, far, y, i + 1) - dip
                curve = diagonal[i]
                slope = max(above - below - curve, 0.0)
            alpha = i + _root(curve, slope, max(target - below, 0.0))
        v = min(max(voltage_min + alpha * cell_width, v), limit_v)
        voltage_v[n] = v
        present = goal
        n += 1
    return n, v


@njit(cache=True)
def _along_fall(target_um: FloatArray, voltage_v: FloatArray, n: int, v: float, start_v: float,
                start_um: float, limit_v: float, limit_um: float, rounding_um: float,
                grid: Grid, table: Table) -> tuple[int, float]:
    """Invert targets from sample `n` on for as long as they fall from one maximum.

    The start is the maximum, the limit the stored minimum; all else is as for `_along_rise`.
    """
    voltage_min, _, cell_width = grid
    _, rows, diagonal, reversible = table
    alpha = (start_v - voltage_min) * (1.0 / cell_width)
    i = cell_of(alpha, diagonal.size)
    x = alpha - i
    own_diagonal, own_reversible = diagonal[i], reversible[i]
    corner = x * (own_reversible + own_diagonal * x)
    near, far = rows[i], rows[i + 1]
    # Distance of the function below the straight line between these two.
    dip = x * (1.0 - x) * own_diagonal
    j, step = i - 1, 0
    curve = slope = above = 0.0
    # The function at the upper and the lower edge of column j; -inf before the first search.
    below = -np.inf
    present = start_um
    while n < target_um.size:
        goal = target_um[n]
        if goal > present or goal <= limit_um:
            break
        target = start_um - goal
        if target <= corner + rounding_um:
            beta = alpha - _root(own_diagonal, own_reversible, min(max(target, 0.0), corner))
        elif i == 0:
            beta = 0.0
        else:
            if below < target - rounding_um:
                guess = max(j - step, 0)
                found = _first_column_below(near, far, x, target - rounding_um + dip, j, guess)
                step, j = j - found, found
                above = between(near, far, x, j + 1) - dip
                below = between(near, far, x, j) - dip
                curve = diagonal[j]
                slope = max(below - above - curve, 0.0)
            beta = j + 1 - _root(curve, slope, max(target - above, 0.0))
        v = max(min(voltage_min + beta * cell_width, v), limit_v)
        voltage_v[n] = v
        present = goal
        n += 1
    return n, v


@njit(cache=True)
def _rise_start(extremes: FloatArray, outputs: FloatArray, top: int,
                goal: float) -> tuple[int, float]:
    """Return the minimum from which a rise to `goal` starts, and the highest voltage on the way."""
    v = extremes[top]
    start = top - 1 if top % 2 == 1 else top
    while start >= 2 and goal > outputs[start - 1]:
        v = extremes[start - 1]
        start -= 2
    return start, v


@njit(cache=True)
def _fall_start(extremes: FloatArray, outputs: FloatArray, top: int,
                goal: float) -> tuple[int, float]:
    """Return the maximum from which a fall to `goal` starts, and the lowest voltage on the way."""
    v = extremes[top]
    start = top - 1 if top % 2 == 0 else top
    while start >= 3 and goal < outputs[start - 1]:
        v = extremes[start - 1]
        start -= 2
    return start, v


@njit(cache=True)
def invert_while_room(target_um: FloatArray, voltage_v: FloatArray, n: int, rounding_um: float,
                      extremes: FloatArray, outputs: FloatArray, top: int, grid: Grid,
                      table: Table) -> tuple[int, int]:
    """Write the voltage from sample `n` on, without allocation, until the memory is full.

    The stacks of the memory are changed in place. Returned are N, or the sample whose reversal does
    not fit into the memory, and the index of the present point in the stacks.
    """
    while n < target_um.size:
        goal = target_um[n]
        if goal == outputs[top]:
            voltage_v[n] = extremes[top]
            n += 1
            continue
        rises = goal > outputs[top]
        if rises:
            start, v = _rise_start(extremes, outputs, top, goal)
            remembered = start >= 2
        else:
            start, v = _fall_start(extremes, outputs, top, goal)
            remembered = start >= 3
        if remembered and goal == outputs[start - 1]:
            top = start - 1
            continue
        if start + 1 == extremes.size:
            break
        top = start + 1
        if rises:
            limit_v = extremes[start - 1] if remembered else grid[1]
            limit_um = outputs[start - 1] if remembered else np.inf
            n, extremes[top] = _along_rise(
                target_um, voltage_v, n, v, extremes[start], outputs[start], limit_v, limit_um,
                rounding_um, grid, table)
        else:
            limit_um = outputs[start - 1] if remembered else -np.inf
            n, extremes[top] = _along_fall(
                target_um, voltage_v, n, v, extremes[start], outputs[start], extremes[start - 1],
                limit_um, rounding_um, grid, table)
        # The target itself is stored, so that a constant target gives a constant voltage.
        outputs[top] = target_um[n - 1]
    return n, top


@njit(cache=True)
def invert(target_um: FloatArray, rounding_um: float, extremes: FloatArray,
           outputs: FloatArray, top: int, grid: Grid, table: Table) -> Past:
    """Return the voltages (V) that bring the output to each target, continuing a stored past.

    The targets, (N,), lie within the output range. No flat stretch is crossed for a remainder below
    `rounding_um`. The stacks of the memory are changed in place, and replaced by longer ones if
    they are full.
    """
    voltage = np.empty(target_um.size)
    n, top = invert_while_room(
        target_um, voltage, 0, rounding_um, extremes, outputs, top, grid, table)
    while n < target_um.size:
        extremes = with_room(extremes, extremes.size)
        outputs = with_room(outputs, outputs.size)
        n, top = invert_while_room(
            target_um, voltage, n, rounding_um, extremes, outputs, top, grid, table)
    return voltage, extremes, outputs, top
