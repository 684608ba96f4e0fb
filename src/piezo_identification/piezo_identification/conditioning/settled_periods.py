# SPDX-License-Identifier: BSD-3-Clause
"""Where a periodic recording has settled: what rang at its start is in no later period."""

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray

FEWEST_PERIODS = 4
"""With fewer, the later half does not tell by how much periods differ among themselves."""

UNLIKE = 1.1
"""Power of a period's difference from the later ones, over the largest of theirs, beyond which it
has not settled. What stays below it is a small part of the noise of the mean period."""


def first_settled_step(signal: FloatArray, steps: NDArray[np.intp], earliest: int) -> int:
    """Find the first step of a square wave from which all periods are alike.

    A mode that rings for long, or a hysteresis whose loop is not closed yet, makes the first
    periods differ from the later ones by more than these differ among themselves. An offset and a
    slope of each period are creep, and do not count.

    Parameters
    ----------
    signal : ndarray, shape (N,)
        Measured displacement.
    steps : ndarray of int
        Samples at which the square wave changes its level.
    earliest : int
        Sample before which none is taken.

    Returns
    -------
    int
        Place in `steps`. Of the periods, no more than the first half is left out; where there are
        few, or the wave is not periodic, it is the first step from the earliest sample on.
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
    # Of equal scatter, one of the later periods is nearer to the mean of which it is a part.
    largest = UNLIKE * powers[half:].max() * (later + 1) / (later - 1)
    alike = np.flatnonzero(powers[:half] <= largest)
    return first + 2 * int(alike[0] if alike.size else half)
