# SPDX-License-Identifier: BSD-3-Clause
"""Measure what a recording is good for: its samples, noise, drift, waveform and start."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from piezo_common.arrays import BoolArray, FloatArray
from piezo_identification.conditioning.outlier_samples import good_samples, with_outliers_marked
from piezo_identification.conditioning.recording_start import square_part
from piezo_identification.conditioning.sensor_noise import (
    noise_floor_um,
    noise_from_repeats_um,
    noise_from_rest_um,
)
from piezo_identification.estimators.hysteresis.density_fit import levels_passed
from piezo_identification.estimators.hysteresis.everett_regression import visited_cells
from piezo_identification.recording_check.waveform_kind import Kind, Waveform, waveform_of
from piezo_models.model_summary import visited_fraction
from piezo_recorder.reading.plausibility import clipped_ends, implausible
from piezo_recorder.reading.recording import Recording

PLANE_CELLS, FEWEST_PLANE_CELLS = 40, 10
"""Cells along a side of the Preisach plane whose visited part is told; the fewest where the voltage
jumps over all of them."""

FEWEST_ROWS = 20
"""With fewer rows nothing but their number and range is told."""

DRIFT_ROWS = 200_000
"""Rows from which the drift is estimated; of longer recordings every second one or fewer."""

SETTLED_NOISES = 5.0
"""A trend at rest that is larger than so many standard deviations of its noise counts."""

MOST_OF_SWING, MOST_OF_NOISE = 1e-3, 4.0
"""Part of the swing, and multiple of the noise of the first rows, that a held voltage may move."""

CREEPS = 1e-4
"""Part of the swing by which the mean voltage of the second half of a hold may differ."""

REST = Waveform(Kind.CONSTANT, "", np.empty(0, dtype=np.intp))

SETTLED_PART = 2e-3
"""Part of the range below which a difference between periods, or a trend at rest, is none."""


@dataclass(frozen=True)
class RecordingCheck:
    """What can be measured of a recording; each property is measured when it is first asked for.

    Parameters
    ----------
    whole : Recording
        What plays in it.
    given : Recording, optional
        It and the rows before and behind it that were left out; by default there are none.
    """

    whole: Recording
    given: Recording | None = None

    @cached_property
    def recording(self) -> Recording:
        """The part that is looked at, its outliers marked: the longest segment of several."""
        return with_outliers_marked(
            max(self.whole.segments, key=lambda each: len(each.voltage_v)))

    @property
    def left_out(self) -> tuple[int, int]:
        """How many rows were left out before what plays, and how many behind it."""
        if self.given is None:
            return 0, 0
        first, last = np.searchsorted(
            self.given.sample_index, self.whole.sample_index[[0, -1]]).tolist()
        return first, len(self.given.voltage_v) - 1 - last

    @property
    def samples(self) -> int:
        """How many samples play."""
        return len(self.whole.voltage_v)

    @property
    def gaps(self) -> int:
        """How many gaps there are."""
        return len(self.whole.gaps)

    @property
    def has_few_rows(self) -> bool:
        """Whether nothing but their number and range is told."""
        return len(self.recording.voltage_v) < FEWEST_ROWS

    @cached_property
    def voltage_v(self) -> FloatArray:
        """Of the part that is looked at, shape (N,)."""
        return np.asarray(self.recording.voltage_v, dtype=float)

    @cached_property
    def displacement_um(self) -> FloatArray:
        """Of the part that is looked at, shape (N,)."""
        return np.asarray(self.recording.displacement_um, dtype=float)

    @property
    def reference_um(self) -> FloatArray:
        """What a tracking run was to follow, shape (N,), nan where unknown; (0,) without a run."""
        return np.asarray(self.recording.reference_um, dtype=float)

    @property
    def sample_period_s(self) -> float:
        """The usual distance of samples."""
        return float(np.median(self.recording.sample_periods_s))

    @cached_property
    def waveform(self) -> Waveform:
        """What the voltage does."""
        if self.has_few_rows:
            return Waveform(Kind.CONSTANT, "too few rows", np.empty(0, dtype=np.intp))
        return waveform_of(self.voltage_v, self.sample_period_s)

    @cached_property
    def noise_um(self) -> float:
        """Standard deviation of the noise; nan where it cannot be told."""
        return np.nan if self.has_few_rows else noise_of(
            self.displacement_um, self.voltage_v, self.waveform)

    @cached_property
    def drift_um(self) -> float:
        """Over the recording, beside what the voltage explains; nan where it cannot be told."""
        return np.nan if self.has_few_rows else drift_of(self.displacement_um, self.voltage_v)

    @cached_property
    def _start(self) -> tuple[str, bool]:
        if self.has_few_rows:
            return "too few rows to tell", False
        before, _ = self.left_out
        if before and self.given is not None:
            # The way from rest, which fits leave out, is known: what came before it is over.
            text, is_settled = start_of(
                self.given.displacement_um, self.given.voltage_v, REST, self.noise_um,
                self.sample_period_s)
            if is_settled:
                return f"{text}, before the rows that are used", True
        return start_of(self.displacement_um, self.voltage_v, self.waveform, self.noise_um,
                        self.sample_period_s)

    @property
    def start(self) -> str:
        """State at the start, for people: at rest, settling, periodic, in motion."""
        return self._start[0]

    @property
    def starts_settled(self) -> bool:
        """Whether nothing of what came before shows."""
        return self._start[1]

    @cached_property
    def visited(self) -> BoolArray:
        """Cells of the Preisach plane over the range of the voltage; see `visited_cells`."""
        if self.has_few_rows or self.swing_v == 0.0:
            return np.zeros((PLANE_CELLS, PLANE_CELLS), dtype=bool)
        return visited_cells(self.voltage_v, np.linspace(
            self.voltage_v.min(), self.voltage_v.max(),
            1 + int(np.clip(levels_passed([self.recording], self.swing_v),
                            FEWEST_PLANE_CELLS, PLANE_CELLS))))

    @cached_property
    def outliers(self) -> int:
        """How many samples stand out of the displacement."""
        return int(np.count_nonzero(~good_samples(self.recording)))

    @cached_property
    def warnings(self) -> list[str]:
        """What is implausible."""
        return implausible(self.whole)

    @property
    def is_clipped(self) -> bool:
        """Whether the sensor stays at an end of its range while the voltage moves on."""
        return bool(clipped_ends(self.whole.displacement_um, self.whole.voltage_v))

    @property
    def swing_v(self) -> float:
        """Range of the voltage."""
        return float(np.ptp(self.recording.voltage_v))

    @property
    def range_um(self) -> float:
        """Range of the displacement without outliers."""
        return float(np.ptp(self.recording.displacement_um))

    @property
    def duration_s(self) -> float:
        """Duration of the part that was looked at."""
        return float(self.recording.time_s[-1])

    @property
    def visited_fraction(self) -> float:
        """Part of the area of the Preisach plane that was visited."""
        return visited_fraction(self.visited)


def check_recording(recording: Recording) -> RecordingCheck:
    """Check what a recording is good for.

    Parameters
    ----------
    recording : Recording
        Of any origin; ramps before and after a waveform are left out.
    """
    playing = recording.playing | recording.tracking
    # As identify does: a table of another program does not say which rows lead to a square wave.
    played = square_part(recording.select(playing) if playing.any() else recording)
    return RecordingCheck(played, recording)


def noise_of(displacement_um: FloatArray, voltage_v: FloatArray, waveform: Waveform) -> float:
    """Return the least standard deviation that rests, repeats and the highest frequencies tell.

    Parameters
    ----------
    displacement_um, voltage_v : ndarray, shape (N,)

    Returns
    -------
    float
        nan where none of them tells.
    """
    found = [noise_floor_um(displacement_um),
             noise_from_rest_um(displacement_um, voltage_v, fewest=50)]
    if waveform.period:
        found.append(noise_from_repeats_um(displacement_um, waveform.period))
    known = [noise for noise in found if noise is not None and np.isfinite(noise)]
    return min(known) if known else np.nan


def drift_of(displacement_um: FloatArray, voltage_v: FloatArray) -> float:
    """Return by how much the displacement drifts at one voltage, over the whole recording.

    A cubic of the voltage, apart for its rise and its fall, and a straight line of time are fitted.

    Parameters
    ----------
    displacement_um, voltage_v : ndarray, shape (N,)

    Returns
    -------
    float
        In um.
    """
    swing_v = float(np.ptp(voltage_v)) or 1.0
    every = slice(None, None, max(1, voltage_v.size // DRIFT_ROWS))
    rising = (np.gradient(voltage_v)[every] > 0.0).astype(float)
    x = (voltage_v[every] - voltage_v.min()) / swing_v
    regressors = np.column_stack([
        np.linspace(0.0, 1.0, x.size), np.ones(x.size), x, x**2, x**3, rising, rising * x])
    return float(np.linalg.lstsq(regressors, displacement_um[every], rcond=1e-10)[0][0])


def start_of(displacement_um: FloatArray, voltage_v: FloatArray, waveform: Waveform,
             noise_um: float, period_s: float) -> tuple[str, bool]:
    """Return the state at the start, for people, and whether it is settled.

    Parameters
    ----------
    displacement_um, voltage_v : ndarray, shape (N,)
    period_s : float
        Of the samples.

    Returns
    -------
    start : str
    is_settled : bool
    """
    range_um = float(np.ptp(displacement_um))
    held = _held_rows(voltage_v)
    if held:
        at = np.arange(held) - 0.5 * (held - 1)
        slope = float(at @ displacement_um[:held] / (at @ at))
        trend_um = slope * held
        deviation_um = noise_um / np.sqrt(at @ at) * held if np.isfinite(noise_um) else 0.0
        where = f"the first {held * period_s:.4g} s at {voltage_v[0]:.5g} V"
        if abs(trend_um) > max(SETTLED_NOISES * deviation_um, SETTLED_PART * range_um):
            return f"still settling: it moves by {trend_um:.3g} um in {where}", False
        return f"at rest: {where}", True
    period = waveform.period
    if period and 2 * period <= len(voltage_v):
        repeats = len(voltage_v) // period
        first = displacement_um[:period]
        last = displacement_um[(repeats - 1) * period : repeats * period]
        change_um = float(np.sqrt(np.mean((first - last) ** 2)))
        if change_um <= max(2.0 * np.sqrt(2.0) * noise_um, SETTLED_PART * range_um):
            return "periodic: its first period is like its last", True
        return (f"in motion: its first period differs from its last by {change_um:.3g} um RMS",
                False)
    return "in motion: the voltage moves from the first row on", False


def _held_rows(voltage_v: FloatArray) -> int:
    """Return in how many rows from the first on the voltage is held; 0 where it moves at once."""
    swing_v = float(np.ptp(voltage_v))
    # Second differences hold the noise, and hardly anything of a smooth motion.
    noise_v = float(np.median(np.abs(np.diff(voltage_v[:FEWEST_ROWS], 2))))
    for most_v in MOST_OF_SWING * swing_v, MOST_OF_NOISE * noise_v:
        moved = np.abs(voltage_v - voltage_v[0]) > most_v
        held = int(np.argmax(moved)) if moved.any() else voltage_v.size
        # A sine that begins at its lowest voltage hardly moves at first, but it moves.
        if held >= FEWEST_ROWS // 2:
            first_v, second_v = (half.mean() for half in np.array_split(voltage_v[:held], 2))
            if abs(first_v - second_v) <= CREEPS * swing_v:
                return held
    return 0
