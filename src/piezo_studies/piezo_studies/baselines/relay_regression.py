# SPDX-License-Identifier: BSD-3-Clause
"""The regression on relays at the cell centres (2.3), in blocks, and its normal equations (2.7)."""

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import BoolArray, FloatArray

ROWS_AT_ONCE = 2000
"""Number of rows of the regression held in memory at once."""


def relay_rows(voltage_v: FloatArray, levels_v: FloatArray,
               on: BoolArray | None = None) -> FloatArray:
    """Return the states of the relays at the cell centres, eq. (2.3), one row per voltage.

    Parameters
    ----------
    voltage_v : ndarray, shape (N,)
    levels_v : ndarray, shape (L + 1,)
        Edges of the cells.
    on : ndarray of bool, shape (L (L + 1) / 2,), optional
        State of the relays before the first voltage, updated in place; all off by default.

    Returns
    -------
    ndarray, shape (N, L (L + 1) / 2)
        States 0 or 1 in the order of the cells: i-major with j <= i.
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
    """Sums M of A_k^T A_k and of A_k^T f(k) over samples, eq. (2.7); A itself is not stored.

    Attributes
    ----------
    matrix : ndarray, shape (unknowns, unknowns)
        Matrix M = A^T A.
    right_side : ndarray, shape (unknowns,)
        Right side A^T Y.
    count : int
        Number of samples.
    """

    def __init__(self, unknowns: int) -> None:
        self.matrix = np.zeros((unknowns, unknowns))
        self.right_side = np.zeros(unknowns)
        self.count = 0

    def add(self, rows: FloatArray, output: FloatArray) -> None:
        """Add samples to the normal equations.

        Parameters
        ----------
        rows : ndarray, shape (N, unknowns)
        output : ndarray, shape (N,)
        """
        self.matrix += rows.T @ rows
        self.right_side += rows.T @ output
        self.count += len(output)


def accumulate(voltage_v: FloatArray, output_um: FloatArray, levels_v: FloatArray,
               samples: NDArray[np.intp] | None = None) -> NormalEquations:
    """Sum the normal equations of a whole recording on the relay grid, block by block.

    Parameters
    ----------
    voltage_v, output_um : ndarray, shape (N,)
        Voltage and output from negative saturation on.
    levels_v : ndarray, shape (L + 1,)
    samples : ndarray of int, optional
        Increasing indices of the samples to use; all by default. Every voltage acts on the relays.
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

    Persistent excitation, appendix A.2, requires L (L + 1) / 2.

    Parameters
    ----------
    voltage_v : ndarray, shape (N,)
        Voltage of the samples used, from negative saturation on.
    levels_v : ndarray, shape (L + 1,)
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

    Parameters
    ----------
    rows : ndarray, shape (N, n)
    output : ndarray, shape (N,)
    gain : float
        Gain gamma_L, between 0 and 1.
    floor : float
        Constant theta, above 0.

    Returns
    -------
    ndarray, shape (n,)

    Raises
    ------
    ValueError
        If gain or floor are out of their ranges.
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
