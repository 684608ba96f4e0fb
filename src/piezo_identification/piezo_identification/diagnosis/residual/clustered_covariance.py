# SPDX-License-Identifier: BSD-3-Clause
"""Covariance of fitted numbers where neighbouring errors are alike (Liang and Zeger 1986)."""

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray


def clustered_covariance(jacobian: FloatArray, residual: FloatArray,
                         cluster: NDArray[np.intp]) -> FloatArray:
    """Return the covariance of numbers that were fitted by least squares.

    Errors of one cluster may be correlated in any way; those of different clusters are not. Where
    all are independent and of one variance, it is that variance over the information, as usual.

    Parameters
    ----------
    jacobian : (n + p, m) array
        Derivatives of the residual; those of a prior come last.
    residual : (n + p,) array
    cluster : (n,) array of int
        Number of the cluster of each row that is no prior; rows of one are neighbours.

    Returns
    -------
    (m, m) array
    """
    widths = np.linalg.norm(jacobian, axis=0)
    widths[widths == 0.0] = 1.0
    scaled, rows = jacobian / widths, cluster.size
    inverse = np.linalg.pinv(scaled.T @ scaled, hermitian=True) / widths[:, None]
    pushes = np.add.reduceat(
        scaled[:rows] * residual[:rows, None], np.flatnonzero(np.diff(cluster, prepend=-1)))
    spread = pushes @ inverse.T
    return np.asarray(spread.T @ spread)
