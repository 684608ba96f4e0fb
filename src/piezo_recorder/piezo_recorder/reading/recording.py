# SPDX-License-Identifier: BSD-3-Clause
"""A recording: samples of a stage in the order of the sample clock."""

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from piezo_common.summary_table import SummaryTable
from piezo_recorder.reading.recording_view import draw_recording, summary_of, text_of
from piezo_recorder.sample_block import Flag

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure


class RecordingError(ValueError):
    """A recording cannot be read; the message says where and what to do."""


@dataclass(frozen=True)
class Recording:
    """Samples of a stage in the order of the sample clock."""

    path: str
    """Path of the file that was read."""
    sample_rate_hz: float
    """Rate of the sample clock."""
    sample_index: np.ndarray
    """Index of each sample on the sample clock, (N,)."""
    sample_periods_s: np.ndarray
    """Distance to the next sample, (N,); longer than the clock's period for a slow waveform."""
    voltage_v: np.ndarray
    """Voltage that is applied from the sample on, (N,)."""
    displacement_um: np.ndarray
    """Displacement that is measured before the voltage acts, (N,)."""
    flags: np.ndarray
    """`Flag` bits, (N,). A CSV file counts as a waveform that plays throughout."""
    gaps: list[tuple[int, int]] = field(default_factory=list)
    """First missing index of the sample clock, and number of missing samples."""
    reference_um: np.ndarray = field(default_factory=lambda: np.empty(0))
    """Reference of a tracking run, (N,) or (0,); NaN for samples without one, empty if none was
    recorded."""
    attachments: dict[str, bytes] = field(default_factory=dict)
    """Files that are stored in the recording."""
    columns: dict[str, np.ndarray] = field(default_factory=dict)
    """Further columns of a table, (N,)."""
    complete: bool = True
    """False if the recorder was killed before it closed the file."""
    notes: list[str] = field(default_factory=list)
    """What was assumed, corrected or found implausible while reading, for users."""
    jitter_s: float = 0.0
    """Standard deviation of the times of the rows from an even clock; 0 on the sample clock."""
    title: str = ""
    """Title that distinguishes several recordings of one file; empty for a single one."""
    sha256: str = ""
    """Hash of samples that came from no file; empty if `path` is a file."""
    axes: tuple[str, ...] = ()
    """Names of several axes: voltage and displacement then have the shape (N, axes)."""

    def __repr__(self) -> str:
        return text_of(self)

    def _repr_html_(self) -> str:
        return self.summary()._repr_html_()

    def summary(self) -> SummaryTable:
        """Return extent, clock and ranges as a table."""
        return summary_of(self)

    def plot(self) -> "Figure":
        """Draw the signals over time and the loop; see `recording_view.draw_recording`."""
        if self.axes:
            raise RecordingError(f"{self.path} has the axes {', '.join(self.axes)}: draw one of "
                                 f"them, as by of_axis({self.axes[0]!r}).plot().")
        return draw_recording(self)

    def to_frame(self) -> "pandas.DataFrame":
        """Return the samples as a pandas frame; see `piezo_recorder.reading.frames.to_frame`."""
        from piezo_recorder.reading.frames import to_frame

        return to_frame(self)

    def to_xarray(self) -> "xarray.Dataset":
        """Return the samples with units; see `piezo_recorder.reading.frames.to_xarray`."""
        from piezo_recorder.reading.frames import to_xarray

        return to_xarray(self)

    @property
    def signals(self) -> dict[str, np.ndarray]:
        """Return voltage and displacement by their labels in a table, each of shape (N,)."""
        return {f"{axis}_{name}" if axis else name: column
                for name in ("voltage_v", "displacement_um")
                for axis, column in zip(self.axes or ("",),
                                        np.atleast_2d(getattr(self, name).T), strict=True)}

    @property
    def time_s(self) -> np.ndarray:
        """Return the time since the first sample, shape (N,)."""
        return (self.sample_index - self.sample_index[0]) / self.sample_rate_hz

    @property
    def sample_period_s(self) -> float:
        """Return the sample period; raise RecordingError if it is not the same throughout."""
        periods_s = np.unique(self.sample_periods_s)
        if len(periods_s) > 1:
            raise RecordingError(
                f"{self.path} has parts with sample periods from {periods_s[0]:g} s to "
                f"{periods_s[-1]:g} s: select one part, such as select(playing).")
        return float(periods_s[0])

    @property
    def playing(self) -> np.ndarray:
        """Return the mask of the samples of waveforms, without ramps, shape (N,)."""
        return self.has(Flag.PLAYING) & ~self.has(Flag.RAMPING)

    @property
    def tracking(self) -> np.ndarray:
        """Return the mask of the samples while the feedforward plays, shape (N,)."""
        return self.has(Flag.TRACKING) & ~self.has(Flag.RAMPING)

    @property
    def segments(self) -> list["Recording"]:
        """Return the parts between gaps, in order; the recording itself if it has no gaps."""
        edges = [first for first, _ in self.gaps]
        bounds = [0, *np.searchsorted(self.sample_index, edges).tolist(), len(self.sample_index)]
        row = np.arange(len(self.sample_index))
        return [self.select((row >= start) & (row < end))
                for start, end in zip(bounds[:-1], bounds[1:], strict=True)] if edges else [self]

    def of_axis(self, axis: str) -> "Recording":
        """Return one of several axes as a separate recording."""
        at = self.axes.index(axis)
        return replace(self, axes=(), title=f"{self.title} {axis}".lstrip(),
                       voltage_v=self.voltage_v[:, at], displacement_um=self.displacement_um[:, at])

    def has(self, flag: int) -> np.ndarray:
        """Return the mask of the samples that have all bits of ``flag``, shape (N,)."""
        return self.flags & np.uint32(flag) == flag

    def select(self, mask: np.ndarray) -> "Recording":
        """Return the recording reduced to some of its samples.

        Parameters
        ----------
        mask : ndarray of bool, shape (N,)

        Raises
        ------
        RecordingError
            If no sample remains.
        """
        if not np.any(mask):
            raise RecordingError(
                f"{self.path} has no sample in the part asked for: "
                "record while the waveform or the tracking runs.")
        sample_index = self.sample_index[mask]
        return replace(
            self, sample_index=sample_index,
            sample_periods_s=self.sample_periods_s[mask], voltage_v=self.voltage_v[mask],
            displacement_um=self.displacement_um[mask], flags=self.flags[mask],
            reference_um=self.reference_um[mask] if self.reference_um.size else self.reference_um,
            columns={name: values[mask] for name, values in self.columns.items()},
            gaps=[gap for gap in self.gaps if sample_index[0] < gap[0] < sample_index[-1]])
