# SPDX-License-Identifier: BSD-3-Clause
"""Spectra of segments of a signal that overlap by half (Welch 1967)."""

from collections.abc import Iterator

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.signal.windows import hann

from piezo_common.arrays import ComplexArray, FloatArray

AT_ONCE = 128
"""Number of segments transformed together, which is much faster than one by one."""


def spectra_of_segments(signal: FloatArray, size: int,
                        drift_order: int) -> Iterator[ComplexArray]:
    """Yield the spectra of segments in batches of shape (segments, lines).

    The drift of each segment is removed, and a Hann window is applied.

    Parameters
    ----------
    signal : ndarray, shape (N,)
    size : int
        Samples of a segment, at most N.
    drift_order : int
        Degree of the polynomial of the drift.
    """
    window = hann(size, sym=False)
    drift = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, size), drift_order + 1))[0]
    segments = sliding_window_view(signal, size)[:: size - size // 2]
    for first in range(0, len(segments), AT_ONCE):
        part = segments[first : first + AT_ONCE]
        yield np.fft.rfft(window * (part - part @ drift @ drift.T))
