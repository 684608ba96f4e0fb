# SPDX-License-Identifier: BSD-3-Clause
"""The regression on relays at the cell centres (2.3), in blocks, and its normal equations (2.7)."""

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import BoolArray, FloatArray

ROWS_AT_ONCE = 2000
"""Number of rows of the regression held in memory at once."""


def relay_rows(voltage_v: FloatArray, levels_v: FloatArray,
               on: BoolArray | None = None) -> FloatArray:
    """Return the states, 0 or 1, of the relays at the cell centres, eq. (2.3), a row per voltage.

    The levels, (L + 1,), are the edges of the cells, whose order is i-major with j <= i. The states
    before the first voltage, (L (L + 1) / 2,), are updated in place; all are off by default.
    """
    # A voltage equal to a threshold must reach it in spite of rounding.
    centres_v = 0.5 * (levels_v[:-1] + levels_v[1:]) - 1e-9 * (levels_v[-1] - levels_v[0])
    i, j = np.tril_indices(centres_v.size)
    on = np.zeros(i.size, dtype=bool) if on is None else on
    rows = np.empty((len(voltage_v), i.size))
    # Relays of one row of the plane switch on together, those of one column off.
    for n, voltage in enumerate(voltage_v):
        on |= (voltage >= centres_v)[i]
        on &= (voltage >= centres_v)[j]
        rows[n] = on
    return rows


class NormalEquations:
    """Sums M = A^T A and A^T Y over samples, eq. (2.7); A itself is not stored."""

    def __init__(self, unknowns: int) -> None:
        self.matrix = np.zeros((unknowns, unknowns))
        self.right_side = np.zeros(unknowns)
        self.count = 0

    def add(self, rows: FloatArray, output: FloatArray) -> None:
        """Add samples: rows of A, (N, unknowns), and their outputs, (N,)."""
        self.matrix += rows.T @ rows
        self.right_side += rows.T @ output
        self.count += len(output)


def accumulate(voltage_v: FloatArray, output_um: FloatArray, levels_v: FloatArray,
               samples: NDArray[np.intp] | None = None) -> NormalEquations:
    """Sum the normal equations of a recording, from negative saturation on, block by block.

    Only the samples with the given increasing indices are used, but every voltage acts on the
    relays.
    """
    size = levels_v.size - 1
    equations = NormalEquations(size * (size + 1) // 2)
    wanted = np.ones(len(voltage_v), dtype=bool)
    if samples is not None:
        wanted[:] = False
        wanted[samples] = True
    on = np.zeros(equations.right_side.size, dtype=bool)
    for start in range(0, len(voltage_v), ROWS_AT_ONCE):
        block = slice(start, start + ROWS_AT_ONCE)
        rows = relay_rows(voltage_v[block], levels_v, on)
        used = wanted[block]
        equations.add(rows[used], output_um[block][used])
    return equations


def excitation_rank(voltage_v: FloatArray, levels_v: FloatArray) -> int:
    """Return the rank of the regression on the relay grid: the number of identifiable densities.

    Persistent excitation, appendix A.2, requires L (L + 1) / 2. The voltages, (N,), are those of
    the samples used, from negative saturation on; the levels are (L + 1,).
    """
    different = set()
    on = np.zeros((levels_v.size - 1) * levels_v.size // 2, dtype=bool)
    for start in range(0, len(voltage_v), ROWS_AT_ONCE):
        rows = relay_rows(voltage_v[start : start + ROWS_AT_ONCE], levels_v, on)
        different |= {row.tobytes() for row in np.packbits(rows.astype(bool), axis=1)}
    packed = np.array([np.frombuffer(row, dtype=np.uint8) for row in sorted(different)])
    return int(np.linalg.matrix_rank(np.unpackbits(packed, axis=1)[:, : on.size].astype(float)))


def projection(rows: FloatArray, output: FloatArray, gain: float = 0.5,
               floor: float = 1.0) -> FloatArray:
    """Update an estimate, which begins at zero, with each sample by a step along its row (2.27).

    The rows are (N, n), the gain gamma_L is between 0 and 1, and the floor theta above 0; other
    numbers raise ValueError.
    """
    if not 0.0 < gain < 1.0 or not floor > 0.0:
        raise ValueError(
            f"the projection has gain {gain:g} and floor {floor:g}: "
            "give a gain between 0 and 1 and a floor above 0"
        )
    estimate = np.zeros(rows.shape[1])
    for row, measured in zip(rows, output, strict=True):
        estimate -= gain * (row @ estimate - measured) / (floor + row @ row) * row
    return estimate
