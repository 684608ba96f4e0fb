# SPDX-License-Identifier: BSD-3-Clause
import numpy as np

from piezo_identification.fitting.nonnegative_regression import nonnegative_least_squares


def test_columns_of_very_different_sizes_have_a_solution():
    # Similar decays, one of them long ago: SciPy's iteration does not end as they stand.
    columns = np.array([
        [77.0, 3.0, 2000.0, 6e28, 2.5e8, 71000.0],
        [0.0, -1.2, 1000.0, 4.6e28, 1.7e8, 44000.0],
        [0.0, 0.0, -980.0, -1e29, -3.1e8, -61000.0],
        [0.0, 0.0, 0.0, -1.7e29, -1.7e8, -11000.0],
        [0.0, 0.0, 0.0, 0.0, -1.2e8, -12000.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, -4200.0]])
    target = np.array([8.1, 0.61, -1.5, -0.39, -0.2, 0.0002])

    solution, norm = nonnegative_least_squares(columns, target)

    residual = target - columns @ solution
    slope = columns.T @ residual / np.linalg.norm(columns, axis=0)
    assert norm == np.linalg.norm(residual)
    assert (solution >= 0.0).all()
    assert slope.max() < 1e-12
    assert np.abs(slope[solution > 0.0]).max() < 1e-12
