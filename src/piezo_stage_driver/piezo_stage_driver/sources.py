# SPDX-License-Identifier: BSD-3-Clause
"""Where the voltage of the next samples comes from."""

import numpy as np


class Hold:
    """One voltage for as long as it is asked."""

    def __init__(self, voltage_v):
        self._voltage_v = voltage_v

    def take(self, count):
        """Return the next samples, shape (count,), in V."""
        return np.full(count, self._voltage_v)


class Ramp:
    """A straight line between two voltages in a number of samples, then the second."""

    def __init__(self, start_v, end_v, samples):
        self._start_v, self._end_v, self._samples = start_v, end_v, samples
        self._at = 0

    def take(self, count):
        """Return the next samples, shape (count,), in V."""
        position = np.arange(self._at + 1, self._at + 1 + count)
        self._at += count
        share = np.minimum(position / max(self._samples, 1), 1.0)
        return (1.0 - share) * self._start_v + share * self._end_v


class Waveform:
    """A sequence, each value held for some samples, played some times, then its last value."""

    def __init__(self, voltage_v, hold_samples, repeats):
        self._voltage_v, self._hold_samples = voltage_v, hold_samples
        self.samples = len(voltage_v) * hold_samples * repeats
        self._at = 0

    def take(self, count):
        """Return the next samples, shape (count,), in V."""
        position = np.minimum(np.arange(self._at, self._at + count), self.samples - 1)
        self._at += count
        return self._voltage_v[position // self._hold_samples % len(self._voltage_v)]


class Feedforward:
    """A part played once, which may grow while it plays, then a part that is repeated."""

    def __init__(self, once_voltage_v, period_voltage_v):
        self._once_v, self._period_v = once_voltage_v, period_voltage_v
        self._at = 0

    @property
    def periodic(self):
        """Whether a part is repeated."""
        return len(self._period_v) > 0

    @property
    def sequence_v(self):
        """Every voltage up to the first repetition, shape (n,), in V."""
        return np.r_[self._once_v, self._period_v, self._period_v[:1]]

    @property
    def exhausted(self):
        """Whether nothing is left to play and the last voltage is held."""
        return not self.periodic and self._at > len(self._once_v)

    def append(self, once_voltage_v):
        """Add samples behind the part that is played once."""
        self._once_v = np.r_[self._once_v, once_voltage_v]

    def rewind(self):
        """Begin anew with the first sample."""
        self._at = 0

    def take(self, count):
        """Return the next samples, shape (count,), in V."""
        position = np.arange(self._at, self._at + count)
        self._at += count
        once = len(self._once_v)
        if not self.periodic:
            return self._once_v[np.minimum(position, once - 1)]
        samples = self._period_v[(position - once) % len(self._period_v)]
        in_once = position < once
        samples[in_once] = self._once_v[position[in_once]]
        return samples
