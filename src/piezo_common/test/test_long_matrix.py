# SPDX-License-Identifier: BSD-3-Clause
"""The triangle of a long matrix."""

import numpy as np
import pytest

from piezo_common.long_matrix import BLOCK, triangle_of


@pytest.mark.parametrize("rows, columns", [
    (10, 20), (BLOCK - 1, 7), (BLOCK, 7), (3 * BLOCK + 5, 40), (2 * BLOCK + 1, BLOCK + 9)])
def test_the_triangle_has_the_products_of_the_columns(rows, columns):
    matrix = np.random.default_rng(rows).normal(size=(rows, columns))
    triangle = triangle_of(matrix)
    assert triangle.shape == (min(rows, columns), columns)
    assert not np.tril(triangle, -1).any()
    np.testing.assert_allclose(triangle.T @ triangle, matrix.T @ matrix, atol=1e-9 * rows)
