# SPDX-License-Identifier: BSD-3-Clause
"""Find where a periodic recording has settled, so that initial ringing has decayed."""

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray

FEWEST_PERIODS = 4
"""Fewest periods for which the later half shows how much settled periods differ."""

UNLIKE = 1.1
"""A period has not settled if the power of its difference from the later ones exceeds the largest
of theirs by this factor. Smaller differences are a small part of the noise of the mean period."""


def first_settled_step(signal: FloatArray, steps: NDArray[np.intp], earliest: int) -> int:
    """Find the first step of a square wave from which all periods are equal.

    A mode that rings for long, or a loop that is not closed yet, makes the first periods differ
    from the later ones by more than these differ from each other. Offset and slope of each period
    are attributed to creep and ignored.

    Parameters
    ----------
    signal : ndarray, shape (N,)
        Measured displacement.
    steps : ndarray of int
        Samples at which the square wave changes its level.
    earliest : int
        Earliest sample of the step.

    Returns
    -------
    int
        Index into `steps`. At most the first half of the periods is excluded. If there are few
        periods, or the wave is not periodic, it is the first step from the earliest sample on.
    """
    first = int(np.searchsorted(steps, earliest))
    kept = steps[first:]
    if kept.size < 3 or np.any(kept[2:] - kept[:-2] != kept[2] - kept[0]):
        return first
    length = int(kept[2] - kept[0])
    count = int(kept[-1] - kept[0]) // length
    if count < FEWEST_PERIODS:
        return first
    periods = signal[kept[0] : kept[0] + count * length].reshape(count, length)
    half = count // 2
    off = periods - periods[half:].mean(axis=0)
    slow = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, length), 2))[0]
    powers = np.sum((off - (off @ slow) @ slow.T) ** 2, axis=1)
    later = count - half
    # A later period is nearer to the mean, of which it is a part, than an early one.
    largest = UNLIKE * powers[half:].max() * (later + 1) / (later - 1)
    alike = np.flatnonzero(powers[:half] <= largest)
    return first + 2 * int(alike[0] if alike.size else half)
