# SPDX-License-Identifier: BSD-3-Clause
"""Collection of a stage's samples into the blocks that are published."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from piezo_stage_driver.engine.sources import Volts

# Flags of a block in addition to those of limits.py; the values are those of SampleBlock.
FLAG_FEEDBACK_HELD = 4
FLAG_RAMPING = 8
FLAG_PLAYING = 16
FLAG_TRACKING = 32
FLAG_STOPPED = 64
FLAG_FEEDFORWARD_HELD = 128

SAMPLES_PER_BLOCK = 40


@dataclass(frozen=True)
class Block:
    """Samples that are published together, see ``piezo_interfaces/SampleBlock``.

    They have the shape (n,), or (n, axes) if the stage has several axes.
    """

    first_sample: int
    sample_period_s: float
    tick: int
    voltage_v: np.ndarray
    displacement_um: np.ndarray
    flags: int
    missed_feedback: int
    feedback_v: np.ndarray | None = None
    """Feedback of each tick, shape (ticks,) or (ticks, axes), if the stage evaluates the feedback
    by itself."""
    marks: np.ndarray | None = None
    """Marks of the samples, shape (n,); None if no sample has one."""
    signal: np.ndarray | None = None
    """What detectors measured with the samples, shape (n, signals); None without detectors."""


class Detected(NamedTuple):
    """What goes beside the voltages and displacements of some samples; see `Block`."""

    marks: np.ndarray | None = None
    signal: np.ndarray | None = None


NOTHING_DETECTED = Detected()


class Filled(NamedTuple):
    """The contents of a full block, and the number of samples of the clock that it covers."""

    samples: int
    voltage_v: np.ndarray
    displacement_um: np.ndarray
    flags: int
    feedback_v: list[Volts]
    detected: Detected


class BlockCollector:
    """Collect samples until they fill a block.

    A published sample is the mean of `decimation` samples of the clock. At the full rate a block
    has `samples_per_block` samples; those of one call of `add` stay together. Of the clock's
    samples, `pending_samples` are not in a block yet.
    """

    def __init__(self) -> None:
        self.decimation = self.samples_per_block = 1
        self._clear()

    def _clear(self) -> None:
        self._voltage_v: list[np.ndarray] = []
        self._displacement_um: list[np.ndarray] = []
        self._feedback_v: list[Volts] = []
        self._marks: list[np.ndarray] = []
        self._signal: list[np.ndarray] = []
        self.pending_samples = self._flags = 0

    def add(self, voltage_v: np.ndarray, displacement_um: np.ndarray, flags: int, ends: bool,
            feedback_v: Volts | None = None,
            detected: Detected = NOTHING_DETECTED) -> "Filled | None":
        """Add samples, and return a block as soon as one is full, else None.

        At the full rate all samples of a block have the same flags: other flags begin a new block.
        Voltages and displacements have the shape (n,) or (n, axes), the feedback (V) of a law on
        board is a number or (axes,). `ends` tells that the samples that follow belong to another
        block.
        """
        before = None
        if self.decimation == 1 and self.pending_samples and flags != self._flags:
            before = self.flush()
        self._voltage_v.append(voltage_v)
        self._displacement_um.append(displacement_um)
        self.pending_samples += len(voltage_v)
        self._flags |= flags
        if feedback_v is not None:
            self._feedback_v.append(feedback_v)
        self._marks.append(np.zeros(len(voltage_v), np.uint8) if detected.marks is None
                           else detected.marks)
        if detected.signal is not None:
            self._signal.append(detected.signal)
        if before is not None:
            return before
        samples = (self.samples_per_block if self.decimation == 1
                   else SAMPLES_PER_BLOCK * self.decimation)
        if not (self.pending_samples >= samples or ends) or self.pending_samples % self.decimation:
            return None
        return self.flush()

    def flush(self) -> Filled:
        """Return the pending samples as a block."""
        filled = Filled(self.pending_samples, self._decimated(self._voltage_v),
                        self._decimated(self._displacement_um), self._flags, self._feedback_v,
                        Detected(self._held_marks(),
                                 self._decimated(self._signal) if self._signal else None))
        self._clear()
        return filled

    def _held_marks(self) -> np.ndarray | None:
        """Return the marks of the published samples, each of which is that of its clock samples."""
        marks = np.concatenate(self._marks)[::self.decimation]
        return marks if marks.any() else None

    def _decimated(self, parts: list[np.ndarray]) -> np.ndarray:
        samples = parts[0] if len(parts) == 1 else np.concatenate(parts)
        if self.decimation == 1:
            return samples
        return samples.reshape(-1, self.decimation, *samples.shape[1:]).mean(axis=1)
