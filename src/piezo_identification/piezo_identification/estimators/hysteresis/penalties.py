# SPDX-License-Identifier: BSD-3-Clause
"""Operators of the density: bounds, curvature, and change along the diagonal.

All operators are sparse. Curvature and translation act on the densities of the cells, the
others on the unknowns of `everett_regression`.
"""

import numpy as np
from scipy.sparse import coo_array, csr_array, eye_array, hstack, vstack

from piezo_identification.estimators.hysteresis.everett_regression import density_operator


def bounded_operator(size: int) -> csr_array:
    """Return the operator of the non-negative quantities: densities and reversible parts.

    It acts on the n (n + 1) / 2 + n unknowns of the regression, and has as many rows.
    """
    crossings = size * (size + 1) // 2
    return vstack([density_operator(size), eye_array(size, crossings + size, k=crossings)]).tocsr()


def curvature_operator(size: int) -> csr_array:
    """Second differences of the n (n + 1) / 2 densities of the cells along both thresholds."""
    cells = np.tril_indices(size)
    number = np.full((size, size), -1)
    number[cells] = np.arange(cells[0].size)
    triples = np.concatenate([
        np.stack([number[:, :-2], number[:, 1:-1], number[:, 2:]], axis=-1).reshape(-1, 3),
        np.stack([number[:-2], number[1:-1], number[2:]], axis=-1).reshape(-1, 3),
    ])
    triples = triples[(triples >= 0).all(axis=1)]
    rows = np.repeat(np.arange(len(triples)), 3)
    values = np.tile([1.0, -2.0, 1.0], len(triples))
    shape = (len(triples), cells[0].size)
    return coo_array((values, (rows, triples.ravel())), shape=shape).tocsr()


def reversible_differences(size: int, order: int) -> csr_array:
    """Return the operator of differences of the reversible parts, and small multiples of these.

    The multiples let the parts be zero where the data do not determine them. It acts on the
    unknowns of the regression, and has 2 n - order rows.
    """
    crossings = size * (size + 1) // 2
    differences = np.diff(np.eye(size), order, axis=0)
    parts = csr_array(np.vstack([differences, np.eye(size) / size**2]))
    return hstack([csr_array((2 * size - order, crossings)), parts]).tocsr()


def translation_operator(size: int) -> csr_array:
    """First differences of the n (n + 1) / 2 densities of the cells along the diagonal."""
    i, j = np.tril_indices(size - 1)
    rows = np.tile(np.arange(i.size), 2)
    columns = np.concatenate([i * (i + 1) // 2 + j, (i + 1) * (i + 2) // 2 + j + 1])
    values = np.repeat([-1.0, 1.0], i.size)
    return coo_array((values, (rows, columns)), shape=(i.size, size * (size + 1) // 2)).tocsr()
