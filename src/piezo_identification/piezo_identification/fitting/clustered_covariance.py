# SPDX-License-Identifier: BSD-3-Clause
"""Covariance of fitted parameters with errors correlated in clusters (Liang and Zeger 1986)."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import pinvh

from piezo_common.arrays import FloatArray

MANY = 10
"""Neighbouring clusters merged into one, in case errors stay correlated over several clusters."""


def clustered_covariance(jacobian: FloatArray, residual: FloatArray,
                         cluster: NDArray[np.intp]) -> FloatArray:
    """Return the covariance of parameters estimated by least squares, (m, m).

    Errors in the same cluster may be correlated in any way; errors in different clusters are
    assumed independent. The variances are also computed with ten neighbouring clusters merged into
    one, and the larger variance is used.

    The Jacobian, (n + p, m), holds the derivatives of the residual, (n + p,); the rows of a prior
    come last. `cluster`, (n,), is the cluster of each row that does not belong to the prior, and
    the rows of a cluster are adjacent.
    """
    widths = np.linalg.norm(jacobian, axis=0)
    widths[widths == 0.0] = 1.0
    scaled, rows = jacobian / widths, cluster.size
    # The divide and conquer of numpy fails for some matrices that are not singular.
    inverse = pinvh(scaled.T @ scaled) / widths[:, None]
    pushes = scaled[:rows] * residual[:rows, None] @ inverse.T
    short, long = (_of_clusters(pushes, number) for number in (cluster, cluster // MANY))
    return widened(short, np.diag(long))


def widened(covariance: FloatArray, variances: FloatArray) -> FloatArray:
    """Return a covariance with the given variances where these are larger, (m, m)."""
    known = np.maximum(np.diag(covariance), np.finfo(float).tiny)
    wider = np.sqrt(np.maximum(variances / known, 1.0))
    return covariance * np.outer(wider, wider)


def jackknife_variances(jacobian: FloatArray, residual: FloatArray,
                        cluster: NDArray[np.intp]) -> FloatArray:
    """Return the variances of parameters by fits without each cluster in turn, (m,) (Efron 1982).

    They hold for a few clusters that contradict each other. The arguments are those of
    `clustered_covariance`; the prior has to determine what no other cluster does.
    """
    widths = np.linalg.norm(jacobian, axis=0)
    widths[widths == 0.0] = 1.0
    scaled, numbers = jacobian / widths, np.unique(cluster)
    square, changes = scaled.T @ scaled, np.zeros((numbers.size, widths.size))
    for change, number in zip(changes, numbers, strict=True):
        rows = np.flatnonzero(cluster == number)
        without = square - scaled[rows].T @ scaled[rows]
        change[:] = np.linalg.lstsq(without, scaled[rows].T @ residual[rows], rcond=None)[0]
    variances: FloatArray = (numbers.size - 1) / numbers.size * np.sum(
        (changes / widths) ** 2, axis=0)
    return variances


def _of_clusters(pushes: FloatArray, cluster: NDArray[np.intp]) -> FloatArray:
    """Return the covariance for the given clusters."""
    together = np.add.reduceat(pushes, np.flatnonzero(np.diff(cluster, prepend=-1)))
    return np.asarray(together.T @ together)
