# SPDX-License-Identifier: BSD-3-Clause
"""The reference of a tracking run, as published by the controller, for each sample."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from piezo_common.arrays import FloatArray

TYPE_NAME = "piezo_interfaces/msg/TrackedReference"


def reference_of(messages: Iterable[Any], sample_index: np.ndarray) -> FloatArray:
    """Return the reference (um) of each sample, NaN if none was published; empty without any.

    The messages are of one run or several, in any order; the indices of the samples rise.
    """
    reference_um = np.full(sample_index.size, np.nan)
    for message in messages:
        first, values = int(message.first_sample), np.asarray(message.displacement_um)
        begin, end = np.searchsorted(sample_index, (first, first + values.size))
        reference_um[begin:end] = values[sample_index[begin:end] - first]
    return reference_um if np.isfinite(reference_um).any() else np.empty(0)
