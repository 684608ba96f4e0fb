# SPDX-License-Identifier: BSD-3-Clause
"""Covariance of fitted numbers where neighbouring errors are alike (Liang and Zeger 1986)."""

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray

MANY = 10
"""So many neighbouring clusters are one where errors are alike for longer than one of them."""


def clustered_covariance(jacobian: FloatArray, residual: FloatArray,
                         cluster: NDArray[np.intp]) -> FloatArray:
    """Return the covariance of numbers that were fitted by least squares.

    Errors of one cluster may be correlated in any way; those of different clusters are not. Where
    all are independent and of one variance, it is that variance over the information, as usual.
    What the errors of ten neighbouring clusters together say of a number counts where it says more.

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
    pushes = scaled[:rows] * residual[:rows, None] @ inverse.T
    short, long = (_of_clusters(pushes, number) for number in (cluster, cluster // MANY))
    variances = np.maximum(np.diag(short), np.finfo(float).tiny)
    wider = np.sqrt(np.maximum(np.diag(long) / variances, 1.0))
    return short * np.outer(wider, wider)


def _of_clusters(pushes: FloatArray, cluster: NDArray[np.intp]) -> FloatArray:
    """Return the covariance where the errors of each cluster push together."""
    together = np.add.reduceat(pushes, np.flatnonzero(np.diff(cluster, prepend=-1)))
    return np.asarray(together.T @ together)
