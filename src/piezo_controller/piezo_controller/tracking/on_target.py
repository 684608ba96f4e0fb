# SPDX-License-Identifier: BSD-3-Clause
"""Time from which on the error of a run has been within its tolerance."""

import numpy as np

from piezo_common.arrays import FloatArray

WINDOW_SAMPLES = 400
STEP_SAMPLES = 40


class OnTarget:
    """Compare the rms error of the last 10 ms at 40 kHz with a tolerance, once a millisecond.

    The result does not depend on how the samples are divided into blocks: `since_sample` is the
    first sample of the earliest window from which on all windows were within the tolerance, and
    None if the last one is not.
    """

    def __init__(self, tolerance_um: float) -> None:
        self._largest = WINDOW_SAMPLES * tolerance_um**2
        self._rest, self._steps = np.empty(0), np.empty(0)
        self._windows_begin = 0
        self.since_sample: int | None = None

    def add(self, error_um: FloatArray) -> None:
        """Add the next errors (um), shape (n,)."""
        rest = np.concatenate([self._rest, error_um * error_um])
        whole = len(rest) // STEP_SAMPLES * STEP_SAMPLES
        self._rest = rest[whole:]
        steps = np.concatenate([self._steps, rest[:whole].reshape(-1, STEP_SAMPLES).sum(axis=1)])
        in_window = WINDOW_SAMPLES // STEP_SAMPLES
        windows = len(steps) - in_window + 1
        if windows > 0:
            self._judge(np.convolve(steps, np.ones(in_window), "valid"))
            steps = steps[windows:]
            self._windows_begin += windows * STEP_SAMPLES
        self._steps = steps

    def _judge(self, windows: FloatArray) -> None:
        """Compare the sums of complete windows, shape (n,), with the tolerance."""
        # Negated, so that NaN counts as outside.
        outside = np.flatnonzero(~(windows <= self._largest))
        if outside.size:
            self.since_sample = None
        first = outside[-1] + 1 if outside.size else 0
        if self.since_sample is None and first < windows.size:
            self.since_sample = self._windows_begin + int(first) * STEP_SAMPLES
