# SPDX-License-Identifier: BSD-3-Clause
"""A compiled Everett look-up that shares no code with the model, as a peer of its kernels.

The Everett function is a table at the crossings of the levels, linear in each voltage between them.
A stack keeps the extremes that are not wiped out, with their outputs, so that a sample changes the
last term alone. Between the crossings the output is an interpolation, where the model's is exact.
"""

import numpy as np
from numba import njit

DEEPEST = 4096
"""Extremes for which the stack has room."""


def table_of(model):
    """Return the Everett function (um) at the crossings of the levels, shape (L + 1, L + 1)."""
    levels_v = model.levels_v
    return np.ascontiguousarray(model.everett_um(levels_v[:, None], levels_v[None, :]))


@njit(cache=True)
def _between(table, high, low):
    size = table.shape[0] - 1
    i, j = min(int(high), size - 1), min(int(low), size - 1)
    x, y = high - i, low - j
    return ((1.0 - x) * ((1.0 - y) * table[i, j] + y * table[i, j + 1])
            + x * ((1.0 - y) * table[i + 1, j] + y * table[i + 1, j + 1]))


@njit(cache=True)
def look_up(voltage_v, table, lowest_v, width_v, offset_um):
    """Return the output (um) of voltages within the table, from negative saturation on."""
    turns, outputs = np.empty(DEEPEST), np.empty(DEEPEST)
    turns[0], outputs[0] = 0.0, offset_um
    count, rising = 1, True
    here, output_um = 0.0, np.empty(voltage_v.size)
    output = offset_um
    for n in range(voltage_v.size):
        now = (voltage_v[n] - lowest_v) / width_v
        if now > here:
            if not rising:
                turns[count], outputs[count] = here, output
                count, rising = count + 1, True
            while count >= 3 and now >= turns[count - 2]:
                count -= 2
            output = outputs[count - 1] + _between(table, now, turns[count - 1])
        elif now < here:
            if rising:
                turns[count], outputs[count] = here, output
                count, rising = count + 1, False
            while count >= 3 and now <= turns[count - 2]:
                count -= 2
            output = outputs[count - 1] - _between(table, turns[count - 1], now)
        here = now
        output_um[n] = output
    return output_um


@njit(cache=True)
def _rise_to(table, low, rise):
    """Return the position at which the output has risen by `rise` from a minimum at `low`."""
    size = table.shape[0] - 1
    j = min(int(low), size - 1)
    y = low - j
    first, last = j, size - 1
    while first < last:
        middle = (first + last + 1) // 2
        if (1.0 - y) * table[middle, j] + y * table[middle, j + 1] <= rise:
            first = middle
        else:
            last = middle - 1
    below = (1.0 - y) * table[first, j] + y * table[first, j + 1]
    above = (1.0 - y) * table[first + 1, j] + y * table[first + 1, j + 1]
    return first + min((rise - below) / max(above - below, 1e-300), 1.0)


@njit(cache=True)
def _fall_to(table, high, fall):
    """Return the position at which the output has fallen by `fall` from a maximum at `high`."""
    size = table.shape[0] - 1
    i = min(int(high), size - 1)
    x = high - i
    first, last = 0, i
    while first < last:
        middle = (first + last) // 2
        if (1.0 - x) * table[i, middle + 1] + x * table[i + 1, middle + 1] <= fall:
            last = middle
        else:
            first = middle + 1
    above = (1.0 - x) * table[i, first + 1] + x * table[i + 1, first + 1]
    below = (1.0 - x) * table[i, first] + x * table[i + 1, first]
    return first + 1 - min((fall - above) / max(below - above, 1e-300), 1.0)


@njit(cache=True)
def invert_look_up(target_um, table, lowest_v, width_v, offset_um):
    """Return the voltages of outputs within the table's range, from negative saturation on."""
    turns, outputs = np.empty(DEEPEST), np.empty(DEEPEST)
    turns[0], outputs[0] = 0.0, offset_um
    count, rising = 1, True
    here, output, voltage_v = 0.0, offset_um, np.empty(target_um.size)
    for n in range(target_um.size):
        goal = target_um[n]
        if goal > output:
            if not rising:
                turns[count], outputs[count] = here, output
                count, rising = count + 1, True
            while count >= 3 and goal >= outputs[count - 2]:
                count -= 2
            here = _rise_to(table, turns[count - 1], goal - outputs[count - 1])
        elif goal < output:
            if rising:
                turns[count], outputs[count] = here, output
                count, rising = count + 1, False
            while count >= 3 and goal <= outputs[count - 2]:
                count -= 2
            here = _fall_to(table, turns[count - 1], outputs[count - 1] - goal)
        output = goal
        voltage_v[n] = lowest_v + here * width_v
    return voltage_v
