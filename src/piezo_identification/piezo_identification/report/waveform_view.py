# SPDX-License-Identifier: BSD-3-Clause
"""Choose the samples of a recording to draw: a mean period, or all of them.

Seconds of data at tens of kilohertz are drawn as a solid block. For a periodic voltage, the mean
period shows more than all samples, and with less noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_identification.recording_check.waveform_kind import Kind, Waveform, waveform_of

EVEN = 0.01
"""Largest difference between the periods of a square wave, as a fraction of a period."""

ALIKE = 0.02
"""Largest RMS difference between the periods of any other voltage, as a fraction of the swing: it
allows noise, but no trend."""

SHORT_S = 1.0
"""Durations below it are shown in milliseconds."""


@dataclass(frozen=True, eq=False)
class WaveformView:
    """The samples that show a recording."""

    kind: Kind

    starts: NDArray[np.intp]
    """First samples of the periods whose mean is drawn; 0 alone if the voltage is not periodic."""
    samples: int
    """Number of samples in a period or, if the voltage is not periodic, in the recording."""
    sample_period_s: float

    jumps: NDArray[np.intp] = field(default_factory=lambda: np.empty(0, dtype=np.intp))
    """Samples at which the voltage changes its level."""

    @property
    def periods(self) -> int:
        """Number of periods in the mean; 1 if all samples are drawn."""
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
        """Title that names what is drawn."""
        return f"mean of {self.periods} periods" if self.is_mean else "whole recording"

    @property
    def time_label(self) -> str:
        """Label of the axis of `time`."""
        what = "time in the period" if self.is_mean else "time"
        return f"{what} ({'ms' if self._is_short else 's'})"

    @property
    def time(self) -> FloatArray:
        """Times of the drawn samples in the unit of `time_label`, shape (samples,)."""
        scale = 1e3 if self._is_short else 1.0
        return np.asarray(np.arange(self.samples) * self.sample_period_s * scale)

    @property
    def _is_short(self) -> bool:
        return self.samples * self.sample_period_s < SHORT_S

    def whole(self, samples: int) -> "WaveformView":
        """Return the view of all samples of the recording."""
        return replace(self, starts=np.zeros(1, dtype=np.intp), samples=samples)

    def mean(self, values: FloatArray) -> FloatArray:
        """Return the mean period of a signal, or the whole signal if there are no periods."""
        return np.asarray(np.mean(
            [values[start : start + self.samples] for start in self.starts], axis=0))


def view_of(voltage_v: FloatArray, sample_period_s: float,
            waveform: Waveform | None = None) -> WaveformView:
    """Choose the samples of a recording to draw, by its voltage, (N,), without gaps."""
    waveform = waveform or waveform_of(voltage_v, sample_period_s)
    first, samples = _period(waveform)
    starts = np.arange(first, voltage_v.size - samples + 1, samples) if samples else np.empty(0)
    if starts.size > 2:
        # The first period is still influenced by the voltage before it.
        starts = starts[1:]
    if starts.size < 2 or not _are_alike(voltage_v, starts.astype(np.intp), samples, waveform):
        starts, samples = np.zeros(1), voltage_v.size
    return WaveformView(waveform.kind, starts.astype(np.intp), samples, sample_period_s,
                        waveform.jumps)


def _are_alike(voltage_v: FloatArray, starts: NDArray[np.intp], samples: int,
               waveform: Waveform) -> bool:
    """Return whether the periods are equal, and not cycles whose amplitude grows or shrinks."""
    if waveform.kind.has_levels:
        return True
    folded = np.stack([voltage_v[start : start + samples] for start in starts])
    spread_v = np.sqrt(np.mean(np.var(folded, axis=0)))
    return bool(spread_v <= ALIKE * np.ptp(voltage_v))


def _period(waveform: Waveform) -> tuple[int, int]:
    """Return the first sample of the first period and the period in samples; 0 if there is none."""
    if not waveform.kind.has_levels:
        return 0, waveform.period
    spans = waveform.jumps[2:] - waveform.jumps[:-2]
    if waveform.kind is not Kind.SQUARE or spans.size < 2:
        return 0, 0
    period = int(np.median(spans))
    # Free-running generators sometimes step a sample early or late, but do not drift.
    whole = np.ptp(waveform.jumps[::2] - period * np.arange(waveform.jumps[::2].size))
    even = np.ptp(spans) <= max(2, EVEN * period) and whole <= max(2, EVEN * period)
    return int(waveform.jumps[0]), period if even else 0


def mean_hold(steps: NDArray[np.intp], voltage_v: FloatArray, signals: Sequence[FloatArray],
              sample_period_s: float) -> tuple[FloatArray, list[FloatArray], int]:
    """Return the mean of signals after the steps of a voltage, with falling steps inverted.

    The voltage changes its level at the samples `steps`. Returned are the time since the step, to
    the end of a usual hold, (M,), the mean of each signal, (M,), and the number of averaged steps.
    """
    edges = np.append(steps, voltage_v.size)
    holds = np.diff(edges)
    length = int(0.98 * np.median(holds))
    middle_v = voltage_v[np.minimum(edges[:-1] + holds // 2, voltage_v.size - 1)]
    change_v = middle_v - voltage_v[np.maximum(steps - 1, 0)]
    if steps[0] == 0:
        # The voltage before the first sample is unknown; the next step goes back.
        change_v[0] = middle_v[0] - middle_v[1] if steps.size > 1 else 1.0
    used = np.flatnonzero(holds >= length)
    means = [np.mean([np.sign(change_v[index]) * values[steps[index] : steps[index] + length]
                      for index in used], axis=0) for values in signals]
    since_s: FloatArray = np.asarray(sample_period_s * np.arange(length), dtype=float)
    return since_s, means, int(used.size)
