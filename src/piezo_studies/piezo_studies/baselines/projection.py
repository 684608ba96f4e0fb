# SPDX-License-Identifier: BSD-3-Clause
"""The projection algorithm (2.27), a baseline that is cheap per sample and converges slowly."""

import numpy as np

from piezo_common.arrays import FloatArray


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
