# SPDX-License-Identifier: BSD-3-Clause
"""Removal of the drift by a polynomial (3.21), for recordings without a model of the creep."""

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray


def remove_polynomial_drift(
    time_s: FloatArray, displacement_um: FloatArray, rest_samples: NDArray[np.intp],
    degree: int = 2,
) -> tuple[FloatArray, np.polynomial.Polynomial]:
    """Remove a polynomial through the samples at rest, eq. (3.21), from a displacement, (N,).

    The samples at rest have equal memory, such as the starts of the harmonics at negative
    saturation, so that differences between them are drift. The displacement, unchanged at the first
    of them, is returned with the drift in um as a function of time in s. Too few of them raise
    ValueError.
    """
    if len(rest_samples) <= degree:
        raise ValueError(
            f"{len(rest_samples)} samples at rest are too few for a drift of degree {degree}: "
            "give more of them or a lower degree"
        )
    drift = np.polynomial.Polynomial.fit(
        time_s[rest_samples], displacement_um[rest_samples], degree
    )
    drift = drift - drift(time_s[rest_samples[0]])
    return displacement_um - drift(time_s), drift
