# SPDX-License-Identifier: BSD-3-Clause
"""Align recordings with the reading time of the displacement that the suite assumes.

A row holds the voltage that is applied from its time on, and the displacement at that time. Some
loggers read the displacement at the end of the hold instead. This is a property of the logger and
not of the stage, so it is corrected in the recording and does not enter the model.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.waveforms import (
    SLOWEST_FAST_ROWS_S,
    played,
    samples_per_mean,
)
from piezo_recorder.reading.recording import Recording

LATEST_READING = 1.5
"""Latest reading time of a row, in sample periods after its voltage."""

POINT_STEP = 0.01
"""Smallest change of the voltage from row to row, as a fraction of its range, for rows that are
points of a loop, each read at rest. The width of the loop depends on whether a displacement belongs
to its own voltage or to the one before."""

CLEARLY_READ = 0.25
"""The row of a jump shows its reading time if its displacement differs by less than this fraction
of the jump from none or all of it."""

HELD = 0.02
"""Largest change between rows of a held voltage, as a fraction of the range."""

JUMP = 0.1
"""Smallest jump of the voltage between samples, as a fraction of the range."""

SIGNIFICANT = 3.0
"""Standard deviations by which an estimate, such as a delay, differs from zero if it is
significant, and an explanation from another one if the data distinguish them."""

MOST_UNCERTAIN = 0.5
"""Largest standard deviation, in sample periods, of an identifiable delay. Beyond it, rows read at
the end of the hold cannot be distinguished from rows read at its beginning."""

MOVES_ON = 0.5
"""Smallest fraction of rows in which a voltage changes that may be straight between its rows."""

STRAIGHT_SAMPLES = 1000
"""Samples of the clock in a row whose voltage is straight up to the next one: many, because each
moves on by a part of the row."""

WHOLE = 1e-9
"""Times within this fraction of a sample period of a sample are equal to its time."""


@dataclass(frozen=True)
class RowDelay:
    """The delay of the displacement of a recording after its voltage."""

    read_at_samples: float
    """Time at which the displacement of a row is read, in sample periods after its voltage changes;
    it was corrected in the recording."""
    delay_s: float
    """Remaining delay of the displacement, in addition to dynamics and delay of the model."""
    standard_deviation_s: float

    sample_period_s: float
    """Sample period of the recording."""

    is_straight: bool = False
    """Whether the voltage is straight between the rows, not held."""

    @property
    def is_identifiable(self) -> bool:
        """Whether the rows determine the delay."""
        return self.standard_deviation_s < MOST_UNCERTAIN * self.sample_period_s

    @property
    def is_significant(self) -> bool:
        """Whether the remaining delay differs significantly from 0."""
        return (self.is_identifiable
                and abs(self.delay_s) > SIGNIFICANT * self.standard_deviation_s)

    def fields(self) -> dict[str, float]:
        """Return the numbers by their names in a model file; the delay only if identifiable."""
        delay = {"delay_s": self.delay_s} if self.is_identifiable else {}
        straight = {"is_straight": True} if self.is_straight else {}
        return {"read_at_samples": self.read_at_samples, **straight, **delay,
                "standard_deviation_s": self.standard_deviation_s}


def rows_read_at_start(recording: Recording, read_at_samples: float) -> Recording:
    """Return a recording whose displacements are those at the times of its rows.

    They were read by `read_at_samples` sample periods after the voltage of their row changed, such
    as 1 for the end of the hold. Rows whose displacement is unknown are left out, and fractions of
    a period are interpolated by cubic splines. Raise ValueError if a row cannot be read so late, or
    the recording is too short.
    """
    if not abs(read_at_samples) <= LATEST_READING:
        raise ValueError(
            f"{recording.path} is declared as read {read_at_samples:g} sample periods after each "
            f"voltage: give a number from 0, the start of the hold, to {LATEST_READING:g}")
    if abs(read_at_samples) < WHOLE:
        return recording
    rows = np.arange(recording.displacement_um.size)
    if rows.size < 4:
        raise ValueError(f"{recording.path} has {rows.size} rows: record longer")
    instants = rows - read_at_samples
    known = (instants >= 0.0) & (instants <= rows[-1])
    aligned = recording.select(known)
    return replace(aligned, displacement_um=_at(recording.displacement_um, instants[known]))


def may_be_straight(recording: Recording) -> bool:
    """Return whether the voltage may be straight between the rows: it moves in most of them.

    It is if a generator plays it while a logger reads both columns at the times of the rows. Means
    of samples are of held voltages.
    """
    part = played(recording)
    moves = np.diff(part.voltage_v) != 0.0
    return samples_per_mean(part) == 1 and bool(np.mean(moves) > MOVES_ON)


def with_straight_voltage(recording: Recording) -> Recording:
    """Return a recording whose voltage is straight between its rows, not held.

    The displacement that answers a straight line from row to row is the mean, over the hold of the
    row, of the one that answers a held voltage. The rows therefore become means over their hold.
    """
    count = STRAIGHT_SAMPLES
    return replace(recording, sample_rate_hz=count * recording.sample_rate_hz,
                   sample_index=count * recording.sample_index,
                   gaps=[(count * first, count * missing) for first, missing in recording.gaps])


def read_as(recording: Recording, read_at_samples: float) -> float:
    """Return the reading time of the rows in sample periods; it is 0 for means of samples."""
    is_means = read_at_samples != 0.0 and samples_per_mean(played(recording)) > 1
    return 0.0 if is_means else read_at_samples


def is_point_by_point(recording: Recording) -> bool:
    """Return whether rows are points of a static loop: slow, and mostly steps of the voltage."""
    part = played(recording)
    steps_v = np.abs(np.diff(part.voltage_v))
    is_step = steps_v > POINT_STEP * np.ptp(part.voltage_v)
    return bool(part.sample_period_s > SLOWEST_FAST_ROWS_S
                and np.count_nonzero(is_step) > 0.5 * is_step.size)


def reading_at_jumps(recording: Recording) -> float | None:
    """Determine from jumps whether slow rows are read with their voltage or after the hold.

    A stage responds within a slow row. The row of a jump holds the displacement before the jump if
    it is read with its voltage. It holds that after the jump if it is read at the end of its hold,
    or if the voltage was measured together with the displacement. Only jumps with a held voltage in
    the rows before and after them are used.

    The result is 0 if rows are read with their voltage, and 1 at the end of the hold. It is None if
    there is no such jump, if rows are fast, averaged or missing, or if the row of the jump shows
    only part of it.
    """
    if recording.gaps:
        return None
    part = played(recording)
    if part.sample_period_s <= SLOWEST_FAST_ROWS_S or samples_per_mean(part) > 1:
        return None
    steps_v = np.diff(part.voltage_v)
    jumps = np.flatnonzero(np.abs(steps_v) > JUMP * np.ptp(part.voltage_v))
    # Require a hold on both sides, which excludes ramps.
    held = np.abs(steps_v) < HELD * np.ptp(part.voltage_v)
    jumps = jumps[(jumps > 0) & (jumps + 1 < steps_v.size)]
    jumps = jumps[held[jumps - 1] & held[jumps + 1]]
    if not jumps.size:
        return None
    moved_um = np.diff(part.displacement_um)
    at_once, later = steps_v[jumps] @ moved_um[jumps], steps_v[jumps] @ moved_um[jumps + 1]
    share = at_once / (at_once + later) if at_once + later else 0.5
    return next((read_at for read_at in (0.0, 1.0) if abs(share - read_at) < CLEARLY_READ), None)


def _at(signal: FloatArray, instants: FloatArray) -> FloatArray:
    whole = np.round(instants)
    if np.abs(instants - whole).max() < WHOLE:
        return signal[whole.astype(int)]
    aligned: FloatArray = CubicSpline(np.arange(signal.size), signal)(instants)
    return aligned


def away_from_jumps(voltage_v: FloatArray) -> NDArray[np.bool_]:
    """Mark the samples that are not next to a jump of the voltage, (N,).

    Within one sample period of a jump, the motion of a stage looks the same for any delay in it.
    """
    jumps = np.flatnonzero(np.abs(np.diff(voltage_v)) > JUMP * np.ptp(voltage_v))
    kept = np.ones(voltage_v.size, dtype=bool)
    for offset in range(-1, 4):
        kept[np.clip(jumps + offset, 0, voltage_v.size - 1)] = False
    return kept


def remaining_delay(
    measured_um: FloatArray, simulated_um: FloatArray, sample_period_s: float,
    nuisance: FloatArray, kept: NDArray[np.bool_] | None = None,
) -> tuple[float, float]:
    """Estimate the delay of a measured signal after a simulated one, both (N,).

    A short delay subtracts the velocity times the delay. Errors may be correlated within a fiftieth
    of the recording; errors of different fiftieths are assumed to be independent. The regressors of
    other differences, such as an offset, are (N, K), and all samples are used unless those to use
    are given, (N,). Return the delay in s and its standard deviation, which is infinite if nothing
    moves.
    """
    velocity = -np.gradient(simulated_um, sample_period_s)
    both = np.column_stack([velocity, measured_um - simulated_um])
    if kept is not None:
        both, nuisance = both[kept], nuisance[kept]
    both = both - nuisance @ np.linalg.lstsq(nuisance, both, rcond=1e-12)[0]
    velocity, difference = both.T
    energy = velocity @ velocity
    if energy == 0.0:
        return 0.0, np.inf
    delay_s = velocity @ difference / energy
    pushes = velocity * (difference - delay_s * velocity)
    stretches = np.add.reduceat(pushes, np.arange(0, pushes.size, -(-pushes.size // 50)))
    return float(delay_s), float(np.linalg.norm(stretches) / energy)
