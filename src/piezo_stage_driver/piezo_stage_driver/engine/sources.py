# SPDX-License-Identifier: BSD-3-Clause
"""Sources of the voltages to be played next.

Samples have the shape (n,), or (n, axes) if the stage has several axes; a voltage then has the
shape (axes,).
"""

from collections import deque
from typing import Protocol

import numpy as np

Volts = float | np.ndarray
"""A voltage, or the voltages of several axes, shape (axes,)."""


def held(voltage_v: Volts, samples: int) -> np.ndarray:
    """Return samples of one voltage, shape (samples,) or (samples, axes)."""
    return np.full((samples, *np.shape(voltage_v)), voltage_v)


class Source(Protocol):
    """A sequence of voltages; each sample is taken once."""

    def take(self, count: int) -> np.ndarray:
        """Return the next samples, shape (count,), in V."""

    @property
    def exhausted(self) -> bool:
        """Return whether the last voltage was held because no samples remained."""


class Hold:
    """A constant voltage of unlimited duration."""

    exhausted = False

    def __init__(self, voltage_v: Volts):
        self._voltage_v = voltage_v

    def take(self, count: int) -> np.ndarray:
        """Return the next samples, shape (count,), in V."""
        return held(self._voltage_v, count)


class Ramp:
    """A straight line between two voltages in a number of samples; then the second is held."""

    exhausted = False

    def __init__(self, start_v: Volts, end_v: Volts, samples: int):
        self._start_v, self._end_v, self._samples = start_v, end_v, samples
        self._at = 0

    def take(self, count: int) -> np.ndarray:
        """Return the next samples, shape (count,), in V."""
        position = np.arange(self._at + 1, self._at + 1 + count)
        self._at += count
        share = np.minimum(position / max(self._samples, 1), 1.0)
        return np.multiply.outer(1.0 - share, self._start_v) + np.multiply.outer(
            share, self._end_v)


class Waveform:
    """A sequence that is repeated, with each value held for some samples; then its last value."""

    exhausted = False

    def __init__(self, voltage_v: np.ndarray, hold_samples: int, repeats: int):
        self._voltage_v, self._hold_samples = voltage_v, hold_samples
        self.samples = len(voltage_v) * hold_samples * repeats
        self._at = 0

    def take(self, count: int) -> np.ndarray:
        """Return the next samples, shape (count,), in V."""
        position = np.minimum(np.arange(self._at, self._at + count), self.samples - 1)
        self._at += count
        return self._voltage_v[position // self._hold_samples % len(self._voltage_v)]


class Marks(Waveform):
    """The marks of the samples of a waveform, shape (n,); none behind its end."""

    def take(self, count: int) -> np.ndarray:
        """Return the marks of the next samples, shape (count,)."""
        left = max(0, self.samples - self._at)
        marks = super().take(count)
        marks[left:] = 0
        return marks


class Feedforward:
    """A part played once, which may grow while it plays, then a part that is repeated.

    Appended samples are dropped once they have been played, so that time and memory of a stream
    depend only on what is loaded ahead.
    """

    def __init__(self, once_voltage_v: np.ndarray, period_voltage_v: np.ndarray):
        self._once_v, self._period_v = once_voltage_v, period_voltage_v
        self._appended: deque[np.ndarray] = deque()
        self._last_v = once_voltage_v[-1] if len(once_voltage_v) else None
        # Position of the next sample: in the once part, then in the first appended chunk,
        # then in the periods.
        self._at = self._in_chunk = 0
        self._appended_played = self._held = False

    @property
    def periodic(self) -> bool:
        """Return whether a part is repeated."""
        return len(self._period_v) > 0

    @property
    def sequence_v(self) -> np.ndarray:
        """Return all voltages loaded first, up to the repetition, in V."""
        return np.concatenate([self._once_v, self._period_v, self._period_v[:1]])

    @property
    def first_v(self) -> Volts:
        """Return the voltage that is played first (V)."""
        return self._once_v[0] if len(self._once_v) else self._period_v[0]

    @property
    def last_v(self) -> Volts | None:
        """Return the last voltage before the next appended part (V)."""
        return self._last_v

    @property
    def exhausted(self) -> bool:
        """Return whether no samples remained and the last voltage was held."""
        return self._held

    def append(self, once_voltage_v: np.ndarray) -> None:
        """Append samples to the part that is played once."""
        self._appended.append(once_voltage_v)
        self._last_v = once_voltage_v[-1]

    @property
    def forgotten(self) -> bool:
        """Return whether appended samples were dropped, so that it cannot be rewound."""
        return self._appended_played

    @property
    def streamed(self) -> bool:
        """Return whether samples were appended to those loaded first."""
        return self._appended_played or bool(self._appended)

    @property
    def lengths(self) -> tuple[int, int]:
        """Return the number of samples that are played once, and of those that are repeated."""
        return len(self._once_v), len(self._period_v)

    def go_on_from(self, other: "Feedforward") -> None:
        """Continue at the present sample of another feedforward of the same lengths."""
        self._at = other._at

    def rewind(self) -> None:
        """Go back to the first sample, unless samples were dropped."""
        self._at, self._held = 0, False

    def take(self, count: int) -> np.ndarray:
        """Return the next samples, shape (count,), in V.

        A stream that ran dry continues where it stopped, without a jump but later than planned.
        """
        taken_v = self._once_v[self._at:self._at + count]
        parts, missing = [taken_v], count - len(taken_v)
        self._held = False
        while missing and self._appended:
            chunk_v = self._appended[0]
            taken_v = chunk_v[self._in_chunk:self._in_chunk + missing]
            parts.append(taken_v)
            missing -= len(taken_v)
            self._in_chunk += len(taken_v)
            self._appended_played = True
            if self._in_chunk == len(chunk_v):
                self._appended.popleft()
                self._in_chunk = 0
        if missing:
            parts.append(self._take_behind_once(missing))
        self._at += count
        parts = [part for part in parts if len(part)]
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def _take_behind_once(self, count: int) -> np.ndarray:
        if not self.periodic:
            self._held = True
            assert self._last_v is not None
            return held(self._last_v, count)
        first = max(self._at - len(self._once_v), 0)
        first %= len(self._period_v)
        if first + count <= len(self._period_v):
            return self._period_v[first:first + count]
        return self._period_v[np.arange(first, first + count) % len(self._period_v)]


class FadeOver:
    """One source, then another, with a smooth transition.

    Both sources advance during the transition. It begins and ends without a step in voltage, slew
    or acceleration, so that no mode of the stage is excited.
    """

    def __init__(self, old: Source, new: Source, samples: int):
        self._old: Source | None = old
        self._new, self._samples = new, samples
        self._at = 0

    @property
    def exhausted(self) -> bool:
        """Return whether the new source held its last voltage."""
        return self._new.exhausted

    def take(self, count: int) -> np.ndarray:
        """Return the next samples, shape (count,), in V."""
        new_v = self._new.take(count)
        if self._old is None:
            return new_v
        part = np.minimum(np.arange(self._at, self._at + count) / self._samples, 1.0)
        share = part**3 * (10.0 + part * (6.0 * part - 15.0))
        voltage_v = self._old.take(count) * (1.0 - share) + new_v * share
        self._at += count
        if self._at >= self._samples:
            self._old = None
        return voltage_v
