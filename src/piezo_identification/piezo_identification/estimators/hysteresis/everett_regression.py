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
    pairs, history = _pairs(
        _positions(voltage_v, levels_v), size, np.asarray(samples, dtype=np.int64))
    branch, is_moving, is_first = _branches(pairs, len(samples))
    older = pairs[is_first & ~is_moving]
    older[:, 0] = branch[older[:, 0].astype(int)]
    branches, moving = (
        csr_array(_rows(part, size, count), shape=(count, size * (size + 3) // 2))
        for part, count in ((older, 1 + int(branch.max(initial=0))),
                            (pairs[is_moving], len(samples))))
    return EverettRegression(branches, branch, moving, history)


def remembered_pairs(
    voltage_v: FloatArray, levels_v: FloatArray, samples: NDArray[np.intp],
) -> tuple[FloatArray, IntArray]:
    """Return the pairs of remembered voltages whose Everett values make up the output.

    The arguments are those of `everett_regression`; only the ends of the levels matter. Each pair,
    (P, 4), has the index among the samples, upper and lower voltage with the range scaled to -1 to
    1, and the sign of the value. The history is as in `EverettRegression`; a sample with a negative
    number has no pairs.
    """
    size = levels_v.size - 1
    pairs, history = _pairs(_positions(voltage_v, levels_v), size, samples.astype(np.int64))
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
    pairs, _ = _pairs(position, len(values), np.arange(1, position.size))
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
def _rows(pairs: FloatArray, size: int, count: int) -> tuple[FloatArray, IntArray, IntArray]:
    """Values, columns and starts of the sparse rows of samples with some pairs."""
    values = np.empty(8 * len(pairs))
    columns = np.empty(8 * len(pairs), np.int64)
    starts = np.zeros(count + 1, np.int64)
    used = 0
    for pair in range(len(pairs)):
        row, alpha, beta, sign = pairs[pair, 0], pairs[pair, 1], pairs[pair, 2], pairs[pair, 3]
        used = _everett_row(values, columns, used, sign, alpha, beta, size)
        starts[int(row) + 1] = used
    for row in range(count):
        starts[row + 1] = max(starts[row + 1], starts[row])
    return values[:used], columns[:used], starts


@njit(cache=True)
def _pairs(position: FloatArray, size: int, samples: IntArray) -> tuple[FloatArray, IntArray]:
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
            for k in range(1, top + 1):
                pairs[count, 0] = row
                pairs[count, 1] = max(extremes[k], extremes[k - 1])
                pairs[count, 2] = min(extremes[k], extremes[k - 1])
                pairs[count, 3] = 1.0 if k % 2 == 1 else -1.0
                count += 1
        row += 1
    return pairs[:count], history


@njit(cache=True)
def _branches(pairs: FloatArray, count: int) -> tuple[IntArray, BoolArray, BoolArray]:
    """Return the branch of each sample, and which pairs are the last and of the first one of each.

    The samples of a branch have the same pairs except for the last one.
    """
    branch = np.zeros(count, np.int64)
    is_moving, is_first = np.zeros(len(pairs), np.bool_), np.zeros(len(pairs), np.bool_)
    number, begun, older, pair = -1, 0, -1, 0
    for row in range(count):
        first = pair
        while pair < len(pairs) and pairs[pair, 0] == row:
            pair += 1
        if pair > first:
            is_moving[pair - 1] = True
        same = max(pair - first - 1, 0) == older
        for k in range(max(pair - first - 1, 0)):
            same = same and (pairs[first + k, 1] == pairs[begun + k, 1]
                             and pairs[first + k, 2] == pairs[begun + k, 2])
        if not same:
            number, begun, older = number + 1, first, max(pair - first - 1, 0)
            is_first[first:pair] = True
        branch[row] = number
    return branch, is_moving, is_first


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
