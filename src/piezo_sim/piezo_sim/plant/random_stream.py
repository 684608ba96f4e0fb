# SPDX-License-Identifier: BSD-3-Clause
"""Random numbers of the plant, independent of how the samples are divided into calls."""

import numpy as np

from piezo_common.arrays import FloatArray

# Drawn in blocks: a draw for 40 samples would cost more than all other work.
_BLOCK = 4096


def bits_for(name: str, seed: int) -> np.random.PCG64:
    """Return random bits of an effect by its name, independent of those of other effects."""
    return np.random.PCG64(np.random.SeedSequence([seed, *name.encode()]))


class NormalStream:
    """Standard normal numbers, one for each sample."""

    def __init__(self, bits: np.random.BitGenerator) -> None:
        self._generator = np.random.Generator(bits)
        self._ahead = np.empty(0)

    def next(self, count: int) -> FloatArray:
        """Return the next numbers, shape (count,)."""
        missing = count - self._ahead.size
        if missing > 0:
            blocks = -(-missing // _BLOCK)
            fresh = self._generator.standard_normal(blocks * _BLOCK)
            self._ahead = np.concatenate([self._ahead, fresh])
        numbers, self._ahead = self._ahead[:count], self._ahead[count:]
        return numbers


class EventStream:
    """Sample numbers of random events, counted from the first sample.

    They are drawn from `bits`; `generator` provides all other random properties of an event.
    """

    def __init__(self, bits: np.random.BitGenerator) -> None:
        self.generator = np.random.Generator(bits)
        self.next = 0
        self._first = 0

    def wait(self, mean_samples: float) -> None:
        """Delay the next event by an exponentially distributed time of at least one sample."""
        self.next += 1 + int(self.generator.exponential(mean_samples))

    def within(self, count: int) -> int | None:
        """Return the position of the next event among the next `count` samples, or None."""
        position = self.next - self._first
        return position if position < count else None

    def advance(self, count: int) -> None:
        """Advance by `count` samples."""
        self._first += count
