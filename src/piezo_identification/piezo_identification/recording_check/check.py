# SPDX-License-Identifier: BSD-3-Clause
"""Measure the properties of a recording: its samples, noise, drift, waveform and start."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from piezo_common.arrays import BoolArray, FloatArray
from piezo_identification.analysis.nonlinear_distortion import (
    NonlinearDistortion,
    distortion_of_signal,
)
from piezo_identification.conditioning.outlier_samples import good_samples, with_outliers_marked
from piezo_identification.conditioning.sensor_noise import noise_estimates_um
from piezo_identification.conditioning.waveforms import square_part
from piezo_identification.estimators.hysteresis.density_fit import levels_passed
from piezo_identification.estimators.hysteresis.everett_regression import visited_cells
from piezo_identification.recording_check.waveform_kind import Kind, Waveform, waveform_of
from piezo_models.model_summary import visited_fraction
from piezo_recorder.reading.plausibility import clipped_ends, implausible
from piezo_recorder.reading.recording import Recording

PLANE_CELLS, FEWEST_PLANE_CELLS = 40, 10
"""Most and fewest cells along a side of the Preisach plane, of which the visited fraction is
reported; a voltage that jumps over levels has fewer cells."""

FEWEST_ROWS = 20
"""Fewest rows for which more than their number and range is reported."""

FEWEST_AT_REST = 50
"""Fewest samples of a rest from which the noise is estimated."""

DRIFT_ROWS = 200_000
"""Most rows, about, from which the drift is estimated; longer recordings are decimated."""

SETTLED_NOISES = 5.0
"""Standard deviations above which a trend at rest is significant."""

MOST_OF_SWING, MOST_OF_NOISE = 1e-3, 4.0
"""Largest change of a held voltage, as a fraction of the swing and as a multiple of the noise."""

CREEPS = 1e-4
"""Largest difference of the mean voltages of the two halves of a hold, as a fraction of the
swing."""

REST = Waveform(Kind.CONSTANT, "", np.empty(0, dtype=np.intp))

SETTLED_PART = 2e-3
"""Difference between periods, or trend at rest, that is negligible, as a fraction of the range."""


@dataclass(frozen=True)
class RecordingCheck:
    """Measured properties of a recording, each computed when it is first used."""

    whole: Recording
    """The part in which a waveform is played."""
    given: Recording | None = None
    """The recording including the omitted rows before and after that part; by default, there are
    none."""

    @cached_property
    def recording(self) -> Recording:
        """The examined part, which is the longest segment, with outliers marked."""
        return with_outliers_marked(
            max(self.whole.segments, key=lambda each: len(each.voltage_v)))

    @property
    def left_out(self) -> tuple[int, int]:
        """Number of rows omitted before and after the examined part."""
        if self.given is None:
            return 0, 0
        first, last = np.searchsorted(
            self.given.sample_index, self.whole.sample_index[[0, -1]]).tolist()
        return first, len(self.given.voltage_v) - 1 - last

    @property
    def samples(self) -> int:
        """Number of samples in which a waveform is played."""
        return len(self.whole.voltage_v)

    @property
    def gaps(self) -> int:
        """Number of gaps."""
        return len(self.whole.gaps)

    @property
    def has_few_rows(self) -> bool:
        """Whether there are too few rows to report more than their number and range."""
        return len(self.recording.voltage_v) < FEWEST_ROWS

    @cached_property
    def voltage_v(self) -> FloatArray:
        """Voltage of the examined part, shape (N,)."""
        return np.asarray(self.recording.voltage_v, dtype=float)

    @cached_property
    def displacement_um(self) -> FloatArray:
        """Displacement of the examined part, shape (N,)."""
        return np.asarray(self.recording.displacement_um, dtype=float)

    @property
    def reference_um(self) -> FloatArray:
        """Reference of a tracking run, shape (N,), nan where unknown; shape (0,) without a run."""
        return np.asarray(self.recording.reference_um, dtype=float)

    @property
    def sample_period_s(self) -> float:
        """Median sample period."""
        return float(np.median(self.recording.sample_periods_s))

    @cached_property
    def waveform(self) -> Waveform:
        """Kind of the voltage."""
        if self.has_few_rows:
            return Waveform(Kind.CONSTANT, "too few rows", np.empty(0, dtype=np.intp))
        return waveform_of(self.voltage_v, self.sample_period_s)

    @cached_property
    def noise_um(self) -> float:
        """Standard deviation of the noise; nan if it cannot be determined."""
        return np.nan if self.has_few_rows else min(noise_estimates_um(
            self.displacement_um, self.voltage_v, self.displacement_um,
            self.waveform.period or None, FEWEST_AT_REST))

    @cached_property
    def drift_um(self) -> float:
        """Drift over the recording at constant voltage; nan if it cannot be determined."""
        return np.nan if self.has_few_rows else drift_of(self.displacement_um, self.voltage_v)

    @cached_property
    def _start(self) -> tuple[str, bool]:
        if self.has_few_rows:
            return "too few rows to determine", False
        before, _ = self.left_out
        if before and self.given is not None:
            # If the stage settled before the ramp from rest, earlier motion has faded.
            text, is_settled = start_of(
                self.given.displacement_um, self.given.voltage_v, REST, self.noise_um,
                self.sample_period_s)
            if is_settled:
                return f"{text}, before the rows that are used", True
        return start_of(self.displacement_um, self.voltage_v, self.waveform, self.noise_um,
                        self.sample_period_s)

    @property
    def start(self) -> str:
        """Description of the state at the start: at rest, settling, periodic or in motion."""
        return self._start[0]

    @property
    def starts_settled(self) -> bool:
        """Whether earlier motion has no visible effect at the start."""
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
        """Number of outliers in the displacement."""
        return int(np.count_nonzero(~good_samples(self.recording)))

    @cached_property
    def distortion(self) -> NonlinearDistortion | None:
        """Distortion at the lines of an odd multisine; None for other voltages, or with gaps."""
        if self.gaps or self.has_few_rows:
            return None
        return distortion_of_signal(
            self.voltage_v, self.displacement_um, self.recording.sample_period_s)

    @cached_property
    def warnings(self) -> list[str]:
        """Sentences on implausible data."""
        return implausible(self.whole)

    @property
    def is_clipped(self) -> bool:
        """Whether the sensor stays at an end of its range while the voltage changes."""
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
        """Duration of the examined part."""
        return float(self.recording.time_s[-1])

    @property
    def visited_fraction(self) -> float:
        """Visited fraction of the Preisach plane."""
        return visited_fraction(self.visited)


def check_recording(recording: Recording) -> RecordingCheck:
    """Check the properties of a recording of any origin, without ramps around a waveform."""
    playing = recording.playing | recording.tracking
    # Tables do not mark the rows that lead to a square wave; `identify` cuts them the same way.
    played = square_part(recording.select(playing) if playing.any() else recording)
    return RecordingCheck(played, recording)


def drift_of(displacement_um: FloatArray, voltage_v: FloatArray) -> float:
    """Return the drift of the displacement over the recording at constant voltage.

    A cubic of the voltage, with a correction for rising voltage, and a line over time are fitted.
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
    """Return a description of the state at the start, and whether it is settled."""
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
    """Return the number of rows for which the voltage is held at the start; 0 if it is not."""
    swing_v = float(np.ptp(voltage_v))
    # Second differences contain the noise, but hardly any smooth motion.
    noise_v = float(np.median(np.abs(np.diff(voltage_v[:FEWEST_ROWS], 2))))
    for most_v in MOST_OF_SWING * swing_v, MOST_OF_NOISE * noise_v:
        moved = np.abs(voltage_v - voltage_v[0]) > most_v
        held = int(np.argmax(moved)) if moved.any() else voltage_v.size
        # A sine that begins at its lowest voltage moves only slowly at first.
        if held >= FEWEST_ROWS // 2:
            first_v, second_v = (half.mean() for half in np.array_split(voltage_v[:held], 2))
            if abs(first_v - second_v) <= CREEPS * swing_v:
                return held
    return 0
