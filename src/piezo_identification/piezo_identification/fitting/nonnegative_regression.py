# SPDX-License-Identifier: BSD-3-Clause
"""Linear regression with coefficients that are at least zero."""

import numpy as np
from scipy.optimize import nnls

from piezo_common.arrays import FloatArray


def nonnegative_least_squares(
    columns: FloatArray, target: FloatArray,
) -> tuple[FloatArray, float]:
    """Return the non-negative solution of a regression, and the norm of its residual.

    Columns may be similar, of very different sizes, or zero.

    Examples
    --------
    >>> import numpy as np
    >>> solution, norm = nonnegative_least_squares(np.eye(2), np.array([3.0, -1.0]))
    >>> print(solution, norm)
    [3. 0.] 1.0
    """
    sizes = np.linalg.norm(columns, axis=0)
    sizes[sizes == 0.0] = 1.0
    solution, norm = nnls(columns / sizes, target, maxiter=30 * sizes.size)
    return solution / sizes, float(norm)
