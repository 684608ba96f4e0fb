# SPDX-License-Identifier: BSD-3-Clause
"""When a logger reads the displacement of a row: recordings aligned to the convention of the suite.

A row holds the voltage that is applied from its instant on, and the displacement at that instant.
Many a logger reads the displacement at the end of the hold instead. That is the logger's habit, and
not the stage's: it is taken out of the recording, and does not enter the model.
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
"""Sample periods after its voltage at which a row may have been read."""

POINT_STEP = 0.01
"""Part of the voltage's range by which it changes from row to row where rows are points of a loop,
each read when the stage has come to rest. Whether such a displacement belongs to its own voltage or
to the one before decides how wide the loop is."""

CLEARLY_READ = 0.25
"""Part of a jump's displacement by which what the row of the jump shows of it may differ from none,
or from all of it, for that to tell when the row is read."""

HELD = 0.02
"""Part of the range within which a voltage is held from one row to the next."""

JUMP = 0.1
"""Part of the range by which the voltage jumps from one sample to the next."""

SIGNIFICANT = 3.0
"""Standard deviations by which a delay that is left has to differ from none."""

MOST_UNCERTAIN = 0.5
"""Standard deviation of a delay, in sample periods, beyond which rows do not tell it: rows that are
read at the end of the hold could then not be told from those that are read at its beginning."""

WHOLE = 1e-9
"""An instant within this part of a sample period counts as that of the sample."""


@dataclass(frozen=True)
class RowDelay:
    """What a recording tells of the delay of its displacement behind its voltage.

    Parameters
    ----------
    read_at_samples : float
        Instant at which the displacement of a row is read, in sample periods after its voltage
        changes: the habit of the logger, which was taken out of the recording.
    delay_s : float
        Of the displacement that is left, beside the dynamics of the model and its delay.
    sample_period_s : float
        Of the recording.
    """

    read_at_samples: float
    delay_s: float
    standard_deviation_s: float
    sample_period_s: float

    @property
    def is_identifiable(self) -> bool:
        """Whether the rows tell a delay at all."""
        return self.standard_deviation_s < MOST_UNCERTAIN * self.sample_period_s

    @property
    def is_significant(self) -> bool:
        """Whether a delay is left that differs from none by more than chance."""
        return (self.is_identifiable
                and abs(self.delay_s) > SIGNIFICANT * self.standard_deviation_s)

    def fields(self) -> dict[str, float]:
        """Return the numbers by their names in a model file; no delay that the rows do not tell."""
        told = {"delay_s": self.delay_s} if self.is_identifiable else {}
        return {"read_at_samples": self.read_at_samples, **told,
                "standard_deviation_s": self.standard_deviation_s}


def rows_read_at_start(recording: Recording, read_at_samples: float) -> Recording:
    """Return a recording whose displacements are those at the instants of its rows.

    Parameters
    ----------
    recording : Recording
        Each displacement was read so many sample periods after the voltage of its row changed.
    read_at_samples : float
        1 for the end of the hold.

    Returns
    -------
    Recording
        With as many rows fewer at the start as tell no displacement of theirs. A fraction of a
        period is interpolated between rows, by cubic splines.

    Raises
    ------
    ValueError
        If a row cannot be read so late, or the recording is too short.
    """
    if not abs(read_at_samples) <= LATEST_READING:
        raise ValueError(
            f"{recording.path} is said to be read {read_at_samples:g} sample periods after each "
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


def read_as(recording: Recording, read_at_samples: float) -> float:
    """Return when a logger of this habit reads rows; means of samples are read as they are."""
    is_means = read_at_samples != 0.0 and samples_per_mean(played(recording)) > 1
    return 0.0 if is_means else read_at_samples


def is_point_by_point(recording: Recording) -> bool:
    """Tell whether rows are points of a static loop: slow, most of them steps of the voltage."""
    part = played(recording)
    steps_v = np.abs(np.diff(part.voltage_v))
    is_step = steps_v > POINT_STEP * np.ptp(part.voltage_v)
    return bool(part.sample_period_s > SLOWEST_FAST_ROWS_S
                and np.count_nonzero(is_step) > 0.5 * is_step.size)


def reading_at_jumps(recording: Recording) -> float | None:
    """Tell from its jumps when slow rows are read: with their voltage, or at the end of the hold.

    A stage answers within a slow row. The row in which the voltage jumps holds the displacement
    from before the jump if it is read with its voltage. It holds that from after the jump if it is
    read at the end of its hold, or if the voltage was measured together with the displacement.
    Jumps count whose voltage is held for a row before and a row after them.

    Returns
    -------
    float or None
        0 with their voltage, 1 at the end of the hold; None where no jump counts, rows are fast,
        means over several samples or missing, or the row of the jump shows only a part of it.
    """
    if recording.gaps:
        return None
    part = played(recording)
    if part.sample_period_s <= SLOWEST_FAST_ROWS_S or samples_per_mean(part) > 1:
        return None
    steps_v = np.diff(part.voltage_v)
    jumps = np.flatnonzero(np.abs(steps_v) > JUMP * np.ptp(part.voltage_v))
    # Held on both sides, so that it is no row of a ramp.
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
    """Mark the samples that lie beside no jump of the voltage.

    What a stage does within one sample period of a jump looks the same for any delay in it.

    Parameters
    ----------
    voltage_v : ndarray, shape (N,)

    Returns
    -------
    ndarray of bool, shape (N,)
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
    """Estimate by how much a measured signal is later than a simulated one.

    A short delay removes the velocity times it. Errors may be alike within a fiftieth of a
    recording; from one to the next they count as independent.

    Parameters
    ----------
    measured_um, simulated_um : ndarray, shape (N,)
    nuisance : ndarray, shape (N, K)
        What else the difference may hold, such as an offset.
    kept : ndarray of bool, shape (N,), optional
        Samples that tell; all by default.

    Returns
    -------
    delay_s, standard_deviation_s : float
        Infinitely uncertain where nothing moves.
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
