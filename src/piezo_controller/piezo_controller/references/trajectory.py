# SPDX-License-Identifier: BSD-3-Clause
"""Displacements over time that can be sampled anywhere, in pieces of any length."""

import threading
from abc import ABC, abstractmethod
from collections import OrderedDict
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_controller.references.smooth_rise import smooth_rise

SURVEYED_SAMPLES = 20_000
BLOCK_SAMPLES = 4000
# Enough for what a stream has loaded ahead, and the block that is answered.
KEPT_BLOCKS = 12


class Trajectory(ABC):
    """A displacement over time; its samples do not depend on how they are divided into pieces."""

    @abstractmethod
    def sample(self, first: int, count: int) -> FloatArray:
        """Return the displacements (um) of `count` samples from `first` on, shape (count,).

        Sample 0 is where the trajectory begins; negative ones lie before it.
        """

    @abstractmethod
    def survey(self, samples: int) -> FloatArray:
        """Return some displacements (um) of the first samples, enough to find their extremes."""


class FormulaTrajectory(Trajectory):
    """A displacement that a formula gives at any time: from sample numbers, (N,), to um."""

    def __init__(self, formula: Callable[[NDArray[np.int64]], FloatArray]) -> None:
        self._formula = formula

    def sample(self, first: int, count: int) -> FloatArray:
        """See `Trajectory.sample`."""
        return self._formula(np.arange(first, first + count))

    def survey(self, samples: int) -> FloatArray:
        """See `Trajectory.survey`: all samples of a short one, irregular ones of a long one."""
        if samples <= SURVEYED_SAMPLES:
            return self.sample(0, samples)
        # One random sample per stretch: regular distances might meet a single phase of the period.
        edges = np.linspace(0, samples, SURVEYED_SAMPLES + 1).astype(np.int64)
        drawn = np.random.default_rng(0).random(SURVEYED_SAMPLES)
        return self._formula(edges[:-1] + (drawn * np.diff(edges)).astype(np.int64))


class JoinedTrajectory(Trajectory):
    """A sequence of trajectories, each faded into the next without a jump.

    Each part has a duration (samples); the last one continues. In the samples of the transition the
    next part takes over from its beginning on, while the previous one continues; no derivative up
    to the second jumps.
    """

    def __init__(self, parts: Sequence[Trajectory], durations: Sequence[int],
                 transition: int) -> None:
        self._parts, self._durations, self._transition = parts, durations, transition
        self._begins = np.r_[0, np.cumsum(durations[:-1], dtype=np.int64)]

    def sample(self, first: int, count: int) -> FloatArray:
        """See `Trajectory.sample`."""
        joined = np.empty(count)
        ends = np.r_[self._begins[1:], np.iinfo(np.int64).max]
        for n, (begin, end) in enumerate(zip(self._begins, ends, strict=True)):
            low = first if n == 0 else max(first, begin)
            high = min(first + count, end)
            if low >= high:
                continue
            piece = self._parts[n].sample(int(low - begin), int(high - low))
            fading = min(high, begin + self._transition) - low if n else 0
            if fading > 0:
                before = self._parts[n - 1].sample(int(low - self._begins[n - 1]), int(fading))
                rise = smooth_rise((np.arange(low, low + fading) - begin) / self._transition)
                piece[:fading] = before + rise * (piece[:fading] - before)
            joined[low - first:high - first] = piece
        return joined

    def survey(self, samples: int) -> FloatArray:
        """See `Trajectory.survey`."""
        remaining = np.clip(samples - self._begins, 0, self._durations)
        remaining[-1] = max(samples - self._begins[-1], 0)
        return np.concatenate([part.survey(int(count)) for part, count in
                               zip(self._parts, remaining, strict=True) if count])


class KeptTrajectory(Trajectory):
    """A trajectory that caches its last blocks, so that repeated samples are not computed again.

    Safe to use from several threads.
    """

    def __init__(self, trajectory: Trajectory) -> None:
        self._trajectory = trajectory
        self._blocks: OrderedDict[int, FloatArray] = OrderedDict()
        self._lock = threading.Lock()

    def sample(self, first: int, count: int) -> FloatArray:
        """See `Trajectory.sample`."""
        at, last, pieces = first, first + count, [np.empty(0)]
        while at < last:
            number, offset = divmod(at, BLOCK_SAMPLES)
            piece = self._block(number)[offset:offset + last - at]
            pieces.append(piece)
            at += piece.size
        return np.concatenate(pieces)

    def survey(self, samples: int) -> FloatArray:
        """See `Trajectory.survey`."""
        return self._trajectory.survey(samples)

    def _block(self, number: int) -> FloatArray:
        with self._lock:
            if number in self._blocks:
                self._blocks.move_to_end(number)
                return self._blocks[number]
        # Computed without the lock, so that other threads need not wait for this block.
        block = self._trajectory.sample(number * BLOCK_SAMPLES, BLOCK_SAMPLES)
        with self._lock:
            self._blocks[number] = block
            if len(self._blocks) > KEPT_BLOCKS:
                self._blocks.popitem(last=False)
        return block
