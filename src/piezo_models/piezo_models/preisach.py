# SPDX-License-Identifier: BSD-3-Clause
"""Preisach hysteresis with a piecewise-constant density, exact through its Everett function.

The relays are 0/1, as in the thesis, eq. (2.1) and (4.2). The output is a sum of Everett
integrals over the remembered voltage extremes, so a sample costs a table look-up, whatever the
number of relays. Wiping-out keeps the memory short, and every remembered extreme keeps its own
output, so no sum runs over time and nothing drifts.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numba import njit

# A target this far outside the output range, relative to its span, is rounding and not a mistake.
_RANGE_TOLERANCE = 1e-9

# A sum of Everett integrals is known to this part of the largest output.
_ROUNDING = 16 * np.finfo(float).eps


@dataclass(eq=False)
class PreisachMemory:
    """What the hysteresis remembers: the alternating voltage extremes that are not wiped out.

    Entry 0 is negative saturation, odd entries are maxima, even entries are minima, and the entry
    at `top` is the present point. Everything above `top` is free space.
    """

    model: "PreisachModel"
    extremes_v: np.ndarray
    outputs_um: np.ndarray
    top: int

    @property
    def voltage_v(self):
        """Present voltage, within the range of the model."""
        return float(self.extremes_v[self.top])

    @property
    def hysteresis_um(self):
        """Present hysteresis output."""
        return float(self.outputs_um[self.top])

    def copy(self):
        """An independent memory with the same past."""
        return replace(self, extremes_v=self.extremes_v.copy(), outputs_um=self.outputs_um.copy())


@dataclass(frozen=True, eq=False)
class PreisachModel:
    """Preisach hysteresis, eq. (2.1), whose density is constant on each cell of a uniform grid.

    Parameters
    ----------
    voltage_min_v, voltage_max_v : float
        Limits of the Preisach triangle. A voltage beyond them acts as the limit: all relays are
        off below `voltage_min_v` and on above `voltage_max_v`.
    density_um_per_v2 : (L, L) array
        Row i is the cell of the upper threshold alpha, column j <= i that of the lower threshold
        beta; zero above the diagonal. The cells on the diagonal are triangles.
    offset_um : float
        Output at negative saturation, where all relays are off.
    reversible_um_per_v : (L,) array, optional
        Density of the relays that switch on and off at one voltage, alpha = beta, on each cell of
        the diagonal: the slope of the output that remains at a reversal. None by default.

    Raises
    ------
    ValueError
        If the limits are not increasing, or the density is not square, not finite, or not zero
        above the diagonal, or the reversible part is not finite or of another length.
    """

    voltage_min_v: float
    voltage_max_v: float
    density_um_per_v2: np.ndarray
    offset_um: float = 0.0
    reversible_um_per_v: np.ndarray | None = None

    def __post_init__(self):
        density = np.array(self.density_um_per_v2, dtype=float)
        if density.ndim != 2 or density.shape[0] != density.shape[1] or density.size == 0:
            raise ValueError(f"density_um_per_v2 has shape {density.shape}; give a square matrix")
        if not np.isfinite(density).all():
            raise ValueError("density_um_per_v2 holds a value that is not finite; remove it")
        if np.triu(density, 1).any():
            raise ValueError(
                "density_um_per_v2 is not zero above the diagonal, where beta would exceed alpha; "
                "give a lower-triangular matrix"
            )
        voltage_min, voltage_max = float(self.voltage_min_v), float(self.voltage_max_v)
        if not (np.isfinite([voltage_min, voltage_max]).all() and voltage_min < voltage_max):
            raise ValueError(
                f"the voltage range {voltage_min} to {voltage_max} V is empty or not finite; "
                "give voltage_min_v below voltage_max_v"
            )
        if not np.isfinite(self.offset_um):
            raise ValueError("offset_um is not finite; give the output at negative saturation")
        reversible = np.zeros(len(density))
        if self.reversible_um_per_v is not None:
            reversible = np.array(self.reversible_um_per_v, dtype=float)
        if reversible.shape != (len(density),) or not np.isfinite(reversible).all():
            raise ValueError(
                f"reversible_um_per_v has shape {reversible.shape} or is not finite; give a number "
                f"for each of the {len(density)} cells of the diagonal"
            )
        density.flags.writeable = reversible.flags.writeable = False
        object.__setattr__(self, "voltage_min_v", voltage_min)
        object.__setattr__(self, "voltage_max_v", voltage_max)
        object.__setattr__(self, "density_um_per_v2", density)
        object.__setattr__(self, "offset_um", float(self.offset_um))
        object.__setattr__(self, "reversible_um_per_v", reversible)

    @property
    def cell_width_v(self):
        """Width of a cell of the grid."""
        return (self.voltage_max_v - self.voltage_min_v) / self.density_um_per_v2.shape[0]

    @property
    def levels_v(self):
        """(L + 1,) edges of the cells."""
        size = self.density_um_per_v2.shape[0]
        return np.linspace(self.voltage_min_v, self.voltage_max_v, size + 1)

    @property
    def output_range_um(self):
        """Output at negative and at positive saturation."""
        span = self.everett_um(self.voltage_max_v, self.voltage_min_v)
        return self.offset_um, self.offset_um + float(span)

    @cached_property
    def _table(self):
        return _everett_table(
            self.density_um_per_v2, self.reversible_um_per_v, self.cell_width_v
        )

    @property
    def _grid(self):
        return self.voltage_min_v, self.voltage_max_v, self.cell_width_v

    def everett_um(self, alpha_v, beta_v):
        """Everett function: the integral of the density over beta_v <= beta <= alpha <= alpha_v.

        It is the rise of the output from a minimum beta_v to alpha_v, and the fall from a maximum
        alpha_v to beta_v.

        Parameters
        ----------
        alpha_v, beta_v : array_like
            Broadcast against each other; limited to the voltage range.

        Returns
        -------
        array
            Exact integral; zero where `alpha_v` <= `beta_v`.

        Raises
        ------
        ValueError
            If a voltage is not finite.
        """
        limits = self.voltage_min_v, self.voltage_max_v
        alpha, beta = np.broadcast_arrays(np.clip(alpha_v, *limits), np.clip(beta_v, *limits))
        if not (np.isfinite(alpha).all() and np.isfinite(beta).all()):
            raise ValueError("alpha_v and beta_v must be finite voltages")
        values = _everett_values(alpha.ravel(), beta.ravel(), *self._grid, *self._table)
        return values.reshape(alpha.shape)[()]

    def memory(self):
        """Memory wiped at `voltage_min_v`: all relays off."""
        extremes, outputs = np.empty(16), np.empty(16)
        extremes[0], outputs[0] = self.voltage_min_v, self.offset_um
        return PreisachMemory(self, extremes, outputs, 0)

    def _own(self, memory):
        if memory is None:
            return self.memory()
        if memory.model is not self:
            raise ValueError(
                "the memory belongs to another model; take one from this model's memory()"
            )
        return memory

    def simulate(self, voltage_v, memory=None):
        """Hysteresis output for a sequence of voltages.

        Parameters
        ----------
        voltage_v : (N,) array_like
            Voltages beyond the range act as its limits.
        memory : PreisachMemory, optional
            Past of this same model; continued, and updated in place. Wiped by default.

        Returns
        -------
        (N,) array
            Output in um.

        Raises
        ------
        ValueError
            If a voltage is not finite, or the memory is that of another model.
        """
        voltage = _finite_sequence(voltage_v, "voltage_v")
        memory = self._own(memory)
        output, memory.extremes_v, memory.outputs_um, memory.top = _simulate(
            voltage, memory.extremes_v, memory.outputs_um, memory.top, *self._grid, *self._table
        )
        return output

    def invert(self, hysteresis_um, memory=None):
        """Voltages whose hysteresis output is the given sequence: the exact inverse.

        The output tells the voltage only where it has a slope. Where the density leaves it flat,
        the voltage moves no further than it must: it stays while the target stays, goes to the
        first voltage that reaches a new target, and returns to the nearest remembered extreme
        whose output is the target, so that a periodic target gives a periodic voltage. Just after
        a reversal the slope starts from zero, and a rounding e of the target moves the voltage by
        at most sqrt(2 e / density).

        Parameters
        ----------
        hysteresis_um : (N,) array_like
        memory : PreisachMemory, optional
            Past of this same model; continued, and updated in place. Wiped by default.

        Returns
        -------
        (N,) array
            Voltage in V.

        Raises
        ------
        ValueError
            If a target is not finite or out of the reachable range, a density is negative, so that
            several voltages give one output, or the memory is that of another model. The memory is
            left untouched.
        """
        target = _finite_sequence(hysteresis_um, "hysteresis_um")
        if (self.density_um_per_v2 < 0).any() or (self.reversible_um_per_v < 0).any():
            raise ValueError(
                "the density has negative cells, so the hysteresis has no inverse; "
                "fit it by non-negative least squares"
            )
        low, high = self.output_range_um
        slack = _RANGE_TOLERANCE * (high - low)
        if target.size and (target.min() < low - slack or target.max() > high + slack):
            raise ValueError(
                f"the hysteresis output cannot span {target.min():.6g} to {target.max():.6g} um; "
                f"the reachable range is {low:.6g} to {high:.6g} um"
            )
        memory = self._own(memory)
        voltage, memory.extremes_v, memory.outputs_um, memory.top = _invert(
            np.clip(target, low, high),
            _ROUNDING * (abs(low) + high - low),
            memory.extremes_v,
            memory.outputs_um,
            memory.top,
            *self._grid,
            *self._table,
        )
        return voltage

    def gain_um_per_v(self, voltage_v=None):
        """Smallest and largest gain of the hysteresis, eq. (3.16).

        The gain is that of the secant from negative saturation. At one voltage it is smallest on
        the way up from negative saturation and largest on the way down from positive saturation.

        Parameters
        ----------
        voltage_v : array_like, optional
            Voltages to look at, above `voltage_min_v`; by default all upper edges of the cells.

        Returns
        -------
        (float, float)
        """
        voltage = self.levels_v[1:] if voltage_v is None else np.asarray(voltage_v, dtype=float)
        if not (voltage > self.voltage_min_v).all():
            raise ValueError(f"the gain needs voltages above voltage_min_v, {self.voltage_min_v} V")
        travel = voltage - self.voltage_min_v
        rising = self.everett_um(voltage, self.voltage_min_v)
        falling = self.everett_um(self.voltage_max_v, self.voltage_min_v) - self.everett_um(
            self.voltage_max_v, voltage
        )
        return float((rising / travel).min()), float((falling / travel).max())


def _finite_sequence(values, name):
    values = np.ascontiguousarray(values, dtype=float)
    if values.ndim != 1:
        raise ValueError(f"{name} has {values.ndim} dimensions; give one sequence")
    if not np.isfinite(values).all():
        first = int(np.flatnonzero(~np.isfinite(values))[0])
        raise ValueError(f"{name} is not finite at sample {first}; remove or replace it")
    return values


def _everett_table(density, reversible, cell_width):
    """Tables that give the Everett function inside any cell in closed form.

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
def _cell_of(position, size):
    return min(int(position), size - 1)


@njit(cache=True)
def _everett(alpha, beta, cells, diagonal, reversible):
    """Everett function at two positions, in cells from voltage_min_v; alpha >= beta."""
    size = diagonal.size
    i = _cell_of(alpha, size)
    j = _cell_of(beta, size)
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
def _everett_values(
    alpha_v, beta_v, voltage_min, voltage_max, cell_width, cells, diagonal, reversible
):
    values = np.zeros(alpha_v.size)
    for n in range(alpha_v.size):
        if alpha_v[n] > beta_v[n]:
            alpha = (alpha_v[n] - voltage_min) / cell_width
            beta = (beta_v[n] - voltage_min) / cell_width
            values[n] = _everett(alpha, beta, cells, diagonal, reversible)
    return values


@njit(cache=True)
def branch_start(extremes, top, value):
    """Index of the extreme from which the branch to `value` starts, after wiping out; -1 if none.

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
def with_room(stack, top):
    """The stack itself, or a longer copy if `top` does not fit into it."""
    if top < stack.size:
        return stack
    longer = np.empty(2 * stack.size)
    longer[: stack.size] = stack
    return longer


@njit(cache=True)
def _simulate(
    voltage, extremes, outputs, top, voltage_min, voltage_max, cell_width,
    cells, diagonal, reversible,
):
    output = np.empty(voltage.size)
    scale = 1.0 / cell_width
    for n in range(voltage.size):
        v = min(max(voltage[n], voltage_min), voltage_max)
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
def _root(quadratic, linear, value):
    """Root of quadratic x^2 + linear x = value in [0, 1]; all non-negative, so nothing cancels."""
    denominator = linear + np.sqrt(linear * linear + 4.0 * quadratic * value)
    if denominator <= 0.0:
        return 0.0
    return min(2.0 * value / denominator, 1.0)


@njit(cache=True)
def _rise(target, rounding, beta, cells, diagonal, reversible):
    """Lowest position alpha, in cells, at which the Everett function from `beta` is `target`.

    No flat stretch is crossed for a rest within `rounding`.
    """
    size = diagonal.size
    j = _cell_of(beta, size)
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
def _fall(target, rounding, alpha, cells, diagonal, reversible):
    """Highest position beta, in cells, at which the Everett function to `alpha` is `target`.

    No flat stretch is crossed for a rest within `rounding`.
    """
    size = diagonal.size
    i = _cell_of(alpha, size)
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
def _invert(
    target,
    rounding,
    extremes,
    outputs,
    top,
    voltage_min,
    voltage_max,
    cell_width,
    cells,
    diagonal,
    reversible,
):
    voltage = np.empty(target.size)
    scale = 1.0 / cell_width
    for n in range(target.size):
        goal = target[n]
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
                alpha = _rise(goal - outputs[top], rounding, beta, cells, diagonal, reversible)
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
                beta = _fall(outputs[top] - goal, rounding, alpha, cells, diagonal, reversible)
                v = max(min(voltage_min + beta * cell_width, v), extremes[top - 1])
            top += 1
        if top == extremes.size:
            extremes, outputs = with_room(extremes, top), with_room(outputs, top)
        extremes[top] = v
        # The target itself is stored, so that a target that stays leaves the voltage where it is.
        outputs[top] = goal
        voltage[n] = v
    return voltage, extremes, outputs, top
