# SPDX-License-Identifier: BSD-3-Clause
"""Which samples of a recording to draw, by its kind of waveform: a mean period, or all of them.

Seconds at tens of kilohertz make a solid block. Where the voltage repeats itself the mean of its
periods shows more than all of them, and with less noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_identification.recording_check.waveform_kind import Kind, Waveform, waveform_of

EVEN = 0.01
"""Part of a period by which the periods of a square wave may differ."""

ALIKE = 0.02
"""Part of the swing by which periods of any other voltage may differ, RMS: noise and no trend."""

SHORT_S = 1.0
"""Times below it are given in milliseconds."""


@dataclass(frozen=True, eq=False)
class WaveformView:
    """The samples that show a recording.

    Parameters
    ----------
    kind : Kind
    starts : ndarray of int
        Of the periods whose mean is drawn; of a voltage that does not repeat itself, its first
        sample.
    samples : int
        Of a period, or of all.
    jumps : ndarray of int
        Samples at which the voltage takes another level.
    """

    kind: Kind
    starts: NDArray[np.intp]
    samples: int
    sample_period_s: float
    jumps: NDArray[np.intp] = field(default_factory=lambda: np.empty(0, dtype=np.intp))

    @property
    def periods(self) -> int:
        """How many periods the mean is of; 1 where all samples are drawn."""
        return int(self.starts.size)

    @property
    def is_mean(self) -> bool:
        """Whether a mean period is drawn."""
        return self.periods > 1

    @property
    def has_levels(self) -> bool:
        """Whether the voltage jumps between levels, so that its loop is a rectangle."""
        return self.kind.has_levels

    @property
    def title(self) -> str:
        """What is drawn, for people."""
        return f"mean of {self.periods} periods" if self.is_mean else "whole recording"

    @property
    def time_label(self) -> str:
        """Label of the axis of `time`."""
        what = "time in the period" if self.is_mean else "time"
        return f"{what} ({'ms' if self._is_short else 's'})"

    @property
    def time(self) -> FloatArray:
        """Of the samples that are drawn, in the unit of `time_label`."""
        scale = 1e3 if self._is_short else 1.0
        return np.asarray(np.arange(self.samples) * self.sample_period_s * scale)

    @property
    def _is_short(self) -> bool:
        return self.samples * self.sample_period_s < SHORT_S

    def whole(self, samples: int) -> "WaveformView":
        """Return the view of all samples of the recording."""
        return replace(self, starts=np.zeros(1, dtype=np.intp), samples=samples)

    def mean(self, values: FloatArray) -> FloatArray:
        """Return the mean period of a signal of the recording, or all of the signal."""
        return np.asarray(np.mean(self._folded(values), axis=0))

    def scatter(self, values: FloatArray) -> float:
        """Return the standard deviation of single samples about the mean period; nan without."""
        if not self.is_mean:
            return float("nan")
        folded = self._folded(values)
        return float(np.sqrt(np.mean(np.var(folded, axis=0, ddof=1))))

    def _folded(self, values: FloatArray) -> FloatArray:
        return np.stack([values[start : start + self.samples] for start in self.starts])


def view_of(voltage_v: FloatArray, sample_period_s: float,
            waveform: Waveform | None = None) -> WaveformView:
    """Choose what to draw of a recording.

    Parameters
    ----------
    voltage_v : ndarray, shape (N,)
        Without gaps.
    waveform : Waveform, optional
        Of the voltage; found from it by default.
    """
    waveform = waveform or waveform_of(voltage_v, sample_period_s)
    first, samples = _period(waveform)
    starts = np.arange(first, voltage_v.size - samples + 1, samples) if samples else np.empty(0)
    if starts.size > 2:
        # The first period still answers to what came before.
        starts = starts[1:]
    if starts.size < 2 or not _are_alike(voltage_v, starts.astype(np.intp), samples, waveform):
        starts, samples = np.zeros(1), voltage_v.size
    return WaveformView(waveform.kind, starts.astype(np.intp), samples, sample_period_s,
                        waveform.jumps)


def _are_alike(voltage_v: FloatArray, starts: NDArray[np.intp], samples: int,
               waveform: Waveform) -> bool:
    """Tell whether periods are the same, and not cycles whose amplitude grows or shrinks."""
    if waveform.kind.has_levels:
        return True
    folded = np.stack([voltage_v[start : start + samples] for start in starts])
    spread_v = np.sqrt(np.mean(np.var(folded, axis=0)))
    return bool(spread_v <= ALIKE * np.ptp(voltage_v))


def _period(waveform: Waveform) -> tuple[int, int]:
    """Return the first sample of a period and the samples of one; 0 samples for no period."""
    if not waveform.kind.has_levels:
        return 0, waveform.period
    spans = waveform.jumps[2:] - waveform.jumps[:-2]
    if waveform.kind is not Kind.SQUARE or spans.size < 2:
        return 0, 0
    period = int(np.median(spans))
    # Free-running generators step a sample earlier or later now and then, but do not drift off.
    whole = np.ptp(waveform.jumps[::2] - period * np.arange(waveform.jumps[::2].size))
    even = np.ptp(spans) <= max(2, EVEN * period) and whole <= max(2, EVEN * period)
    return int(waveform.jumps[0]), period if even else 0


def mean_hold(steps: NDArray[np.intp], voltage_v: FloatArray, signals: Sequence[FloatArray],
              sample_period_s: float) -> tuple[FloatArray, list[FloatArray], int]:
    """Return the mean of signals after the steps of a voltage, falling ones turned round.

    Parameters
    ----------
    steps : ndarray of int
        Samples at which the voltage takes another level.
    voltage_v : ndarray, shape (N,)
    signals : sequence of ndarray, shape (N,)

    Returns
    -------
    since_s : ndarray, shape (M,)
        From the first sample behind a step to the end of the shortest usual hold.
    means : list of ndarray, shape (M,)
    count : int
        Steps of which it is the mean.
    """
    edges = np.append(steps, voltage_v.size)
    holds = np.diff(edges)
    length = int(0.98 * np.median(holds))
    middle_v = voltage_v[np.minimum(edges[:-1] + holds // 2, voltage_v.size - 1)]
    change_v = middle_v - voltage_v[np.maximum(steps - 1, 0)]
    if steps[0] == 0:
        # Nobody knows from where it came: the next one goes back.
        change_v[0] = middle_v[0] - middle_v[1] if steps.size > 1 else 1.0
    used = np.flatnonzero(holds >= length)
    means = [np.mean([np.sign(change_v[index]) * values[steps[index] : steps[index] + length]
                      for index in used], axis=0) for values in signals]
    since_s: FloatArray = np.asarray(sample_period_s * np.arange(length), dtype=float)
    return since_s, means, int(used.size)
