# SPDX-License-Identifier: BSD-3-Clause
"""Covariance of fitted parameters with errors correlated in clusters (Liang and Zeger 1986)."""

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray

MANY = 10
"""Neighbouring clusters merged into one, in case errors stay correlated over several clusters."""


def clustered_covariance(jacobian: FloatArray, residual: FloatArray,
                         cluster: NDArray[np.intp]) -> FloatArray:
    """Return the covariance of parameters estimated by least squares, (m, m).

    Errors in the same cluster may be correlated in any way; errors in different clusters are
    assumed independent. The variances are also computed with ten neighbouring clusters merged
    into one, and the larger variance is used.

    Parameters
    ----------
    jacobian : (n + p, m) array
        Derivatives of the residual; the rows of a prior come last.
    residual : (n + p,) array
    cluster : (n,) array of int
        Cluster of each row that does not belong to the prior; the rows of a cluster are adjacent.
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
    """Return the covariance for the given clusters."""
    together = np.add.reduceat(pushes, np.flatnonzero(np.diff(cluster, prepend=-1)))
    return np.asarray(together.T @ together)
