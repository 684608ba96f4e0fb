# SPDX-License-Identifier: BSD-3-Clause
"""Follow values that are not known in advance, with bounded speed and acceleration.

A signal within the declared band and amplitude keeps to the bounds by Bernstein's inequality, and
is followed exactly. Jumps, kinks and another initial position go into an offset that fades out.
Where the declared range is known, the motion brakes before its ends: a signal of this band is never
faster there (Szego 1928).
"""

import math

import numpy as np
from numba import njit

from piezo_common.arrays import FloatArray

SLACK = 1.001
"""Factor on the bounds that allows for rounding errors."""
FAR = 0.1
"""Deviation, as a part of the amplitude, from which on a sample counts as far from its value.
Straight lines between slow values stay below it, up to half of the declared band."""


class BoundedMotion:
    """Follow values sample by sample, from a position at rest, after a first value.

    Values up to a frequency, and a peak-to-peak amplitude, are followed exactly. The motion stays
    in a range that contains the values, by default any. `far_samples` counts those that the bounds
    kept more than `FAR` of the amplitude from their value.
    """

    def __init__(self, start_um: float, first_um: float, band_hz: float, amplitude_um: float,
                 sample_period_s: float,
                 range_um: tuple[float, float] = (-math.inf, math.inf)) -> None:
        turn = 2.0 * math.pi * band_hz * sample_period_s
        self._largest_step_um = SLACK * turn * amplitude_um / 2.0
        self._largest_bend_um = self._largest_step_um * turn
        self._decay = turn
        # Previous value, previous step, the offset and its step.
        self._state = np.array([first_um, 0.0, start_um - first_um, 0.0])
        self._far_um = FAR * amplitude_um
        self._range_um = range_um
        self.far_samples = 0

    def follow(self, values_um: FloatArray) -> FloatArray:
        """Return the motion (um) for the next values, shape (n,)."""
        followed_um = _follow(values_um, self._state, self._largest_step_um,
                              self._largest_bend_um, self._decay, *self._range_um)
        self.far_samples += int(np.count_nonzero(np.abs(followed_um - values_um) > self._far_um))
        return followed_um


@njit(cache=True)
def _follow(values: FloatArray, state: FloatArray, largest_step: float, largest_bend: float,
            decay: float, lowest: float, highest: float) -> FloatArray:
    followed = np.empty(values.size)
    last, step, offset, fading = state
    for i in range(values.size):
        wanted, position = values[i] - last, last + offset
        taken = min(max(wanted, step - largest_bend, -largest_step),
                    step + largest_bend, largest_step)
        offset += taken - wanted
        # Critically damped: fades out without overshoot.
        fading -= decay * (2.0 * fading + decay * offset)
        fading = min(max(fading, -largest_step), largest_step)
        # From a faster step, the motion could not brake before the end of the range.
        down = math.sqrt(2.0 * largest_bend * max(position - lowest, 0.0))
        up = math.sqrt(2.0 * largest_bend * max(highest - position, 0.0))
        braked = min(max(taken + fading, -down), up) - (taken + fading)
        taken += braked
        offset += fading + braked
        followed[i] = values[i] + offset
        last, step = values[i], taken
    state[:] = last, step, offset, fading
    return followed
