# SPDX-License-Identifier: BSD-3-Clause
"""Means of neighbouring values."""

import numpy as np

from piezo_common.arrays import FloatArray, IntArray


def block_means(values: FloatArray, length: int) -> FloatArray:
    """Return the means of so many successive values along the last axis, without a shorter rest."""
    count = values.shape[-1] // length
    return np.asarray(values[..., : count * length].reshape(
        *values.shape[:-1], count, length).mean(axis=-1))


def means_in_bins(number: IntArray, *columns: FloatArray) -> list[FloatArray]:
    """Return the mean of each column, (N,), in the bins that hold a value, in ascending order.

    The numbers of the bins, (N,), are not negative.
    """
    counts = np.bincount(number)
    used = counts > 0
    return [np.bincount(number, column)[used] / counts[used] for column in columns]
