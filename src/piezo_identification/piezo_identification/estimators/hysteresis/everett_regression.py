# SPDX-License-Identifier: BSD-3-Clause
"""Sparse regression of the Preisach hysteresis on its Everett function, for any grid.

A sample is a sum of a few Everett values, one per remembered extreme, whereas a regression on the
density involves every active cell. The unknowns are the Everett values at the crossings of the
levels, followed by the reversible parts of the n cells of the diagonal; together they determine the
densities. Crossings (i + 1, j) and cells (i, j) have the same numbers: i-major with j <= i.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from piezo_common.arrays import BoolArray, FloatArray
from piezo_identification.simulation.past_search import NEAR_THE_END
from piezo_models.hysteresis.preisach_kernels import branch_start, cell_of, with_room

IntArray = NDArray[np.int64]

SparseRows = tuple[FloatArray, IntArray, IntArray]
"""Values, columns, and the index of the first entry of each row and of the end."""

ENTRIES = 8
"""Largest number of unknowns in one Everett value."""

ROUNDED = 1e-4
"""Rounding of older remembered voltages, relative to the range."""

NEAR_A_LEVEL = 0.02
"""Distance from a level, in cells, within which a voltage counts as on it for visited cells."""


@dataclass(frozen=True, eq=False)
class EverettRegression:
    """Rows of the regression.

    Between two reversals only the last of the remembered extremes moves.
    """

    branches: csr_array
    """Part of the rows that is the same in each branch, (B, u)."""
    branch: IntArray
    """Number of the branch of each sample, (N,)."""
    moving: csr_array
    """Part of the rows that depends on the last extreme, (N, u)."""
    history: IntArray
    """Samples with the same number share an offset, (N,). 0: the memory is known. Positive: the
    memory is known for the voltages seen so far, and the rest has not changed. -1: the voltage has
    not been here before, and its effect depends on the unknown past."""

    @cached_property
    def matrix(self) -> csr_array:
        """The output is `matrix @ unknowns` plus an offset, (N, u)."""
        return self.branches[self.branch] + self.moving

    def output_um(self, unknowns: FloatArray) -> FloatArray:
        """Return the output without its offset, (N,)."""
        return np.asarray((self.branches @ unknowns)[self.branch] + self.moving @ unknowns)

    def select(self, mask: BoolArray) -> "EverettRegression":
        """Return the regression of some samples, (N,)."""
        kept, branch = np.unique(self.branch[mask], return_inverse=True)
        return EverettRegression(
            self.branches[kept], branch, self.moving[mask], self.history[mask])


def everett_regression(
    voltage_v: FloatArray, levels_v: FloatArray, samples: NDArray[np.intp] | None = None,
) -> EverettRegression:
    """Return the regression of the hysteresis output on Everett values at crossings of levels.

    The density is constant in each cell, so this is exactly eq. (2.3) in other unknowns. The memory
    before the first voltage is unknown. It no longer matters once the voltage has reached either
    end of the levels, provided that no relays switch beyond them.

    The levels, (n + 1,), are uniform and increasing; of the voltages, (N,), those beyond them act
    as the outermost level. `samples` are increasing indices of the voltages whose rows are
    computed; all by default.
    """
    samples = np.arange(len(voltage_v)) if samples is None else samples
    size = levels_v.size - 1
    of_branches, branch, of_samples, history = _regression(
        _positions(voltage_v, levels_v), size, np.asarray(samples, dtype=np.int64))
    branches, moving = (
        csr_array(rows, shape=(rows[2].size - 1, size * (size + 3) // 2))
        for rows in (of_branches, of_samples))
    return EverettRegression(branches, branch, moving, history)


def histories(voltage_v: FloatArray, levels_v: FloatArray,
              samples: NDArray[np.intp]) -> IntArray:
    """Return the `history` of an `everett_regression` alone; its arguments are the same."""
    return _histories(_positions(voltage_v, levels_v), levels_v.size - 1, samples.astype(np.int64))


def remembered_pairs(
    voltage_v: FloatArray, levels_v: FloatArray, samples: NDArray[np.intp],
) -> tuple[FloatArray, IntArray]:
    """Return the pairs of remembered voltages whose Everett values make up the output.

    The arguments are those of `everett_regression`; only the ends of the levels matter. Each pair,
    (P, 4), has the index among the samples, upper and lower voltage with the range scaled to -1 to
    1, and the sign of the value. Remembered voltages other than the present one are rounded to
    `ROUNDED` of the range, and pairs that then cancel are left out: a chirp may remember thousands
    of voltages. The history is as in `EverettRegression`; a sample with a negative number has no
    pairs.
    """
    size = levels_v.size - 1
    pairs, history = _pairs(
        _positions(voltage_v, levels_v), size, samples.astype(np.int64), ROUNDED * size)
    pairs[:, 1:3] = 2.0 * pairs[:, 1:3] / size - 1.0
    return pairs, history


def density_operator(size: int) -> csr_array:
    """Return the operator of the densities of cells, times the area of a full one.

    It acts on the unknowns of the regression, and is (n (n + 1) / 2, n (n + 1) / 2 + n): the mixed
    second difference. On the diagonal, where a cell is a half cell, it is twice the Everett value
    without the reversible part.
    """
    i, j = np.tril_indices(size)
    cell = np.arange(i.size)
    inner = i > j
    neighbour = cell - i  # crossing (i, j)
    corners = [
        (cell, cell, np.where(inner, 1.0, 2.0)),
        (cell[inner], neighbour[inner], np.array(-1.0)),
        (cell[inner], cell[inner] + 1, np.array(-1.0)),
        (cell[i > j + 1], neighbour[i > j + 1] + 1, np.array(1.0)),
        (cell[i == j], cell.size + np.arange(size), np.array(-2.0)),
    ]
    return coo_array(
        (
            np.concatenate([np.broadcast_to(value, row.shape) for row, _, value in corners]),
            (
                np.concatenate([row for row, *_ in corners]),
                np.concatenate([column for _, column, _ in corners]),
            ),
        ),
        shape=(cell.size, cell.size + size),
    ).tocsr()


def visited_cells(voltage_v: FloatArray, levels_v: FloatArray,
                  samples: NDArray[np.intp] | None = None) -> BoolArray:
    """Return the cells of the Preisach plane, (n, n), in which the corner of the memory has been.

    Only there does the output determine the density of each cell. One full loop switches all
    relays, but its corner moves along two sides of the triangle only. The row is that of the cell's
    alpha, the column that of its beta; cells above the diagonal are False. The arguments are those
    of `everett_regression`; `samples` are those whose output is known.
    """
    position = _positions(voltage_v, levels_v)
    level = np.round(position)
    position = np.where(np.abs(position - level) < NEAR_A_LEVEL, level, position)
    known = np.zeros(position.size, dtype=bool)
    known[... if samples is None else samples] = True
    return _visited(position, known, levels_v.size - 1)


def summed_over_corners(
    values: FloatArray, voltage_v: FloatArray, levels_v: FloatArray,
) -> FloatArray:
    """Sum a value of the cells over the corners of the memory at each sample, (N,).

    The values, (n, n), have the row of a cell's alpha and the column of its beta. The voltages,
    (N,), come after negative saturation, and the levels, (n + 1,), are uniform and increasing.
    """
    # After the lowest level, the memory of every sample is known.
    position = np.concatenate([[0.0], _positions(voltage_v, levels_v)])
    pairs, _ = _pairs(position, len(values), np.arange(1, position.size), 0.0)
    # On an edge, the cell whose upper edge it is.
    upper = np.maximum(np.ceil(pairs[:, 1]).astype(int) - 1, 0)
    lower = np.minimum(pairs[:, 2].astype(int), upper)
    return np.asarray(np.bincount(
        pairs[:, 0].astype(int), values[upper, lower], len(voltage_v)), dtype=float)


def _positions(voltage_v: FloatArray, levels_v: FloatArray) -> FloatArray:
    """Voltages in units of cells above level 0."""
    size = levels_v.size - 1
    width_v = (levels_v[-1] - levels_v[0]) / size
    return np.clip((np.asarray(voltage_v, dtype=float) - levels_v[0]) / width_v, 0.0, size)


@njit(cache=True)
def _crossing(i: int, j: int) -> int:
    return (i - 1) * i // 2 + j


@njit(cache=True)
def _reversible(i: int, size: int) -> int:
    return size * (size + 1) // 2 + i


@njit(cache=True)
def _put(values: FloatArray, columns: IntArray, count: int, value: float, column: int) -> int:
    if value == 0.0:
        return count
    values[count] = value
    columns[count] = column
    return count + 1


@njit(cache=True)
def _everett_row(values: FloatArray, columns: IntArray, count: int, sign: float, alpha: float,
                 beta: float, size: int) -> int:
    """Append the weights of the unknowns in sign times the Everett value at (alpha, beta)."""
    i = cell_of(alpha, size)
    j = cell_of(beta, size)
    if i == j:
        way = alpha - beta
        count = _put(values, columns, count, sign * way * way, _crossing(i + 1, i))
        return _put(values, columns, count, sign * (way - way * way), _reversible(i, size))
    x = alpha - i
    y = j + 1 - beta
    count = _put(values, columns, count, sign * x * y, _crossing(i + 1, j))
    count = _put(values, columns, count, sign * (1.0 - x) * y, _crossing(i, j))
    count = _put(values, columns, count, sign * x * (1.0 - y), _crossing(i + 1, j + 1))
    if i > j + 1:
        count = _put(values, columns, count, sign * (1.0 - x) * (1.0 - y), _crossing(i, j + 1))
    # On the diagonal, the density adds the square of the way, the reversible part the way.
    count = _put(values, columns, count, sign * (x * x - x), _crossing(i + 1, i))
    count = _put(values, columns, count, sign * (x - x * x), _reversible(i, size))
    count = _put(values, columns, count, sign * (y * y - y), _crossing(j + 1, j))
    return _put(values, columns, count, sign * (y - y * y), _reversible(j, size))


@njit(cache=True)
def _follow(position: FloatArray, n: int, extremes: FloatArray, top: int, seen: FloatArray,
            size: int) -> tuple[FloatArray, int, int]:
    """Memory after sample n: extremes, top, and history number (see above).

    `seen` contains the lowest and highest voltage, the present number, and the last one used.
    """
    v = position[n]
    if n == 0:
        extremes[0] = v
        seen[0], seen[1], seen[2], seen[3] = v, v, 1.0, 1.0
        top = 0
    slack = NEAR_THE_END * size
    if seen[2] != 0.0 and (v <= slack or v >= size - slack):
        # The whole memory is erased: all relays are off, or on.
        seen[0], seen[1], seen[2] = 0.0, size, 0.0
        extremes[0] = 0.0
        extremes[1] = v
        return extremes, 1 if v > 0.0 else 0, 0
    if n == 0:
        return extremes, top, -1
    outside = v < seen[0] or v > seen[1]
    if outside:
        if seen[2] >= 0.0:
            seen[3] += 1.0
        seen[2] = -1.0
        seen[1] = max(seen[1], v)
        if v < seen[0]:
            seen[0] = v
            extremes[0] = v
            return extremes, 0, -1
    elif seen[2] < 0.0 and v != extremes[top]:
        seen[2] = seen[3]
    if v != extremes[top]:
        top = branch_start(extremes, top, v) + 1
        extremes = with_room(extremes, top)
        extremes[top] = v
    return extremes, top, -1 if outside else int(seen[2])


@njit(cache=True)
def _histories(position: FloatArray, size: int, samples: IntArray) -> IntArray:
    history = np.empty(samples.size, np.int64)
    extremes, seen = np.empty(16), np.zeros(4)
    top, row = 0, 0
    for n in range(position.size):
        if row == samples.size:
            break
        extremes, top, number = _follow(position, n, extremes, top, seen, size)
        if samples[row] == n:
            history[row] = number
            row += 1
    return history


@njit(cache=True)
def _regression(position: FloatArray, size: int, samples: IntArray) -> tuple[
        SparseRows, IntArray, SparseRows, IntArray]:
    """Return the rows of the branches, the branch of each sample, its own row, and its history.

    The samples of a branch remember the same extremes except for the last one.
    """
    older, own = (np.empty(64), np.empty(64, np.int64)), (np.empty(64), np.empty(64, np.int64))
    of_branch, of_sample = np.zeros(samples.size + 2, np.int64), np.zeros(
        samples.size + 1, np.int64)
    branch, history = np.zeros(samples.size, np.int64), np.empty(samples.size, np.int64)
    extremes, begun, seen = np.empty(16), np.empty(0), np.zeros(4)
    place = np.full(size * (size + 3) // 2, -1, np.int64)
    top, row, number, used, count = 0, 0, -1, 0, 0
    for n in range(position.size):
        if row == samples.size:
            break
        extremes, top, known = _follow(position, n, extremes, top, seen, size)
        if samples[row] != n:
            continue
        history[row] = known
        # Without a known past, no pair counts.
        last = top if known >= 0 else 0
        if number < 0 or not np.array_equal(begun, extremes[: max(last, 1)]):
            number, begun = number + 1, extremes[: max(last, 1)].copy()
            older = _with_room_for(older, used + ENTRIES * last)
            used = _summed_pairs(*older, used, begun, 1, last, size, place)
            of_branch[number + 1] = used
        branch[row] = number
        if last > 0:
            own = _with_room_for(own, count + ENTRIES)
            count = _summed_pairs(*own, count, extremes, last, last + 1, size, place)
        of_sample[row + 1] = count
        row += 1
    return ((older[0][:used], older[1][:used], of_branch[: max(number, 0) + 2]), branch,
            (own[0][:count], own[1][:count], of_sample), history)


@njit(cache=True)
def _with_room_for(entries: tuple[FloatArray, IntArray],
                   count: int) -> tuple[FloatArray, IntArray]:
    """Return values and columns, copied to longer arrays if there is no room for so many."""
    values, columns = entries
    if count <= values.size:
        return entries
    longer, of_longer = np.empty(2 * count), np.empty(2 * count, np.int64)
    longer[: values.size] = values
    of_longer[: values.size] = columns
    return longer, of_longer


@njit(cache=True)
def _summed_pairs(values: FloatArray, columns: IntArray, first: int, extremes: FloatArray,
                  begin: int, end: int, size: int, place: IntArray) -> int:
    """Write the weights in some pairs of neighbouring extremes, one for each unknown.

    `place` is -1 for all unknowns. Return the number of entries with these.
    """
    count = first
    for k in range(begin, end):
        count = _everett_row(
            values, columns, count, 1.0 if k % 2 == 1 else -1.0,
            max(extremes[k], extremes[k - 1]), min(extremes[k], extremes[k - 1]), size)
    used = first
    for entry in range(first, count):
        at = place[columns[entry]]
        if at < 0:
            place[columns[entry]] = used
            values[used], columns[used] = values[entry], columns[entry]
            used += 1
        else:
            values[at] += values[entry]
    for entry in range(first, used):
        place[columns[entry]] = -1
    return used


@njit(cache=True)
def _pairs(position: FloatArray, size: int, samples: IntArray,
           rounded: float) -> tuple[FloatArray, IntArray]:
    """Return the pairs of remembered positions; see `remembered_pairs` for their rounding."""
    pairs = np.empty((16 * samples.size + 64, 4))
    history = np.empty(samples.size, np.int64)
    extremes = np.empty(16)
    seen = np.zeros(4)
    top, row, count = 0, 0, 0
    for n in range(position.size):
        extremes, top, number = _follow(position, n, extremes, top, seen, size)
        if row == samples.size:
            break
        if samples[row] != n:
            continue
        history[row] = number
        if number >= 0:
            if count + top > len(pairs):
                longer = np.empty((2 * len(pairs) + top, 4))
                longer[:count] = pairs[:count]
                pairs = longer
            first, before = count, _near(extremes[0], rounded)
            for k in range(1, top + 1):
                v = extremes[k] if k == top else _near(extremes[k], rounded)
                upper, lower, before = max(v, before), min(v, before), v
                if count > first and pairs[count - 1, 1] == upper and (
                        pairs[count - 1, 2] == lower):
                    count -= 1
                    continue
                pairs[count, 0], pairs[count, 1], pairs[count, 2] = row, upper, lower
                pairs[count, 3] = 1.0 if k % 2 == 1 else -1.0
                count += 1
        row += 1
    return pairs[:count], history


@njit(cache=True)
def _near(position: float, rounded: float) -> float:
    return position if rounded == 0.0 else np.round(position / rounded) * rounded


@njit(cache=True)
def _visited(position: FloatArray, known: BoolArray, size: int) -> BoolArray:
    visited = np.zeros((size, size), np.bool_)
    extremes = np.empty(16)
    seen = np.zeros(4)
    top = 0
    for n in range(position.size):
        v = position[n]
        before = extremes[top] if n else v
        highest = extremes[1] if top >= 2 else -1.0
        extremes, top, number = _follow(position, n, extremes, top, seen, size)
        if number < 0 or not known[n]:
            continue
        # Cells that are jumped over are not visited.
        if abs(v - before) > 1.0 + 1e-9:
            before = v
        if top == 0:
            if highest > 0.0:
                visited[_upper_cell(highest), 0 : _upper_cell(before) + 1] = True
        elif top % 2 == 1:
            j = cell_of(extremes[top - 1], size)
            first = cell_of(max(before, extremes[top - 1]), size)
            visited[max(first, j) : _upper_cell(v) + 1, j] = True
        else:
            i = _upper_cell(extremes[top - 1])
            last = _upper_cell(min(before, extremes[top - 1]))
            visited[i, cell_of(v, size) : min(last, i) + 1] = True
    return visited


@njit(cache=True)
def _upper_cell(position: float) -> int:
    """Return the cell below a position; on an edge, the cell whose upper edge it is."""
    return max(int(np.ceil(position)) - 1, 0)
