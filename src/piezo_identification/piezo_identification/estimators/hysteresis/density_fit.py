# SPDX-License-Identifier: BSD-3-Clause
"""Preisach density from recordings, after removal of the linear dynamics."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.creep_removal import (
    remove_creep,
    remove_creep_of_held,
)
from piezo_identification.conditioning.outlier_samples import good_samples
from piezo_identification.conditioning.segments import (
    Recordings,
    played_segments,
    voltage_range_v,
)
from piezo_identification.conditioning.settling import (
    first_settled,
    held_delay_s,
    low_frequency_delay_s,
)
from piezo_identification.estimators.hysteresis.density_estimate import DensityEstimate
from piezo_identification.estimators.hysteresis.dynamics_inverse import (
    follows_fast,
    remove_dynamics,
)
from piezo_identification.estimators.hysteresis.equations import HysteresisSegment
from piezo_identification.estimators.hysteresis.smoothed_density import density_of_segments
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder.reading.recording import Recording

LEVELS = 70
"""Largest number of levels above the lowest voltage."""

FEWEST_LEVELS = 4
"""Fewest levels for which a density is estimated; fewer show only a line."""

MOST_ROWS = 20_000
"""Largest number of samples that a density is fitted to: far more than it has cells."""

STANDING_SHARE = 0.5
"""Smallest share of rows with nearly the voltage of the row before for which levels count."""

LARGE_STEP_SHARE = 0.9
"""Quantile of the voltage steps from sample to sample that is used as the height of a level."""


def estimate_density(
    recording: Recordings, creep: CreepDynamics, dynamics: ElectricVibrationDynamics,
    level_count: int | None = None, cells_per_level: int = 2,
    smoothing_weight: float | None = None, translation_weight: float = 0.0,
    delay_s: float = 0.0, most_levels: int = LEVELS, most_rows: int = MOST_ROWS,
) -> DensityEstimate:
    """Estimate the Preisach density on a uniform grid over the voltages played.

    Creep and fast dynamics are removed by their inverses, Fig. 4.8. The result is a linear
    regression (4.11), solved by smoothed non-negative least squares with all samples; offset and
    initial creep are free. Any input is suitable: `DensityEstimate.visited` shows which part of the
    plane it determines. If a line predicts held-out data as well, the hysteresis is a line.

    Parameters
    ----------
    recording : Recording or sequence of Recording
        Recordings of the hysteresis experiment, or any others. For their start see
        `everett_regression`; after a gap a recording starts anew. Several recordings share all but
        offset and initial creep. Marked outliers are neither fitted nor held out.
    level_count : int, optional
        Number of levels L above level 0; by default `most_levels`, or as many as the voltage steps
        resolve.
    cells_per_level : int
        Number of cells of the model between levels.
    smoothing_weight, translation_weight : float, optional
        Weights of `density_of_segments`; by default, the smoothing is chosen on held-out branches.
    delay_s : float
        Delay of the measurement in addition to the dynamics.
    most_rows : int
        Largest number of samples that are fitted, spaced evenly.

    Raises
    ------
    ValueError
        If the voltage does not change or never returns, or the displacement falls where the
        voltage rises, both as measured and with the dynamics removed.

    Examples
    --------
    >>> import numpy as np
    >>> from piezo_models import CreepDynamics, ElectricVibrationDynamics, PreisachModel
    >>> from piezo_recorder import recording_of
    >>> stage = PreisachModel(0.0, 10.0, np.tril(np.full((5, 5), 0.04)))
    >>> time_s = 0.01 * np.arange(500)
    >>> voltage_v = (5.0 - 5.0 * np.cos(6.3 * time_s)) * np.linspace(1.0, 0.2, 500)
    >>> estimate = estimate_density(recording_of({
    ...     "time_s": time_s, "voltage_v": voltage_v,
    ...     "displacement_um": stage.simulate(voltage_v)}),
    ...     CreepDynamics(), ElectricVibrationDynamics(), level_count=5)
    >>> estimate.is_line, estimate.model().density_um_per_v2.shape
    (False, (10, 10))
    """
    parts = played_segments(recording)
    segments = [segment_of(part, creep, dynamics, delay_s) for part in parts]
    if _falls(segments):
        # The inverse of inexact dynamics may turn the sign near a resonance.
        segments = [segment_of(part, creep, ElectricVibrationDynamics(), 0.0) for part in parts]
        if _falls(segments):
            path = parts[0].path
            raise ValueError(f"{path}: the displacement falls where the voltage rises: "
                             "reverse the sign of one")
    return density_of_parts(parts, segments, level_count, cells_per_level, smoothing_weight,
                            translation_weight, most_levels, most_rows)


def density_of_parts(
    parts: Sequence[Recording], segments: Sequence[HysteresisSegment],
    level_count: int | None = None, cells_per_level: int = 2,
    smoothing_weight: float | None = None, translation_weight: float = 0.0,
    most_levels: int = LEVELS, most_rows: int = MOST_ROWS, is_of_plays: bool = False,
) -> DensityEstimate:
    """Estimate the density from inputs and outputs of the hysteresis in parts of recordings.

    The options are those of `estimate_density` and of `density_of_segments`. Raise ValueError if
    the voltage does not change or never returns.
    """
    segments = _thinned(segments, most_rows)
    lowest_v, highest_v = voltage_range_v(parts)
    passed = levels_passed(parts, highest_v - lowest_v)
    is_line = passed < FEWEST_LEVELS
    if level_count is None:
        level_count = max(min(passed, most_levels), FEWEST_LEVELS)
    edges_v = np.linspace(lowest_v, highest_v, level_count * cells_per_level + 1)
    return density_of_segments(
        segments, edges_v, level_count, smoothing_weight, translation_weight, is_line, is_of_plays)


def _thinned(segments: Sequence[HysteresisSegment], most_rows: int) -> list[HysteresisSegment]:
    """Return segments with so many samples together, spaced evenly, and their former weights.

    The longest ones lose the most, so that they leave the rows of short ones as they are. The
    weights have a mean of 1.
    """
    left, sizes = most_rows, sorted(segment.samples.size for segment in segments)
    for number, size in enumerate(sizes):
        most = max(left // (len(sizes) - number), 1)
        left -= min(size, most)
    thinned = []
    for segment in segments:
        every = max(1, -(-segment.samples.size // most))
        thinned.append(replace(
            segment, samples=segment.samples[::every], weight=every * segment.weight))
    rows = sum(segment.samples.size for segment in thinned)
    whole = sum(segment.samples.size * segment.weight for segment in thinned)
    return [replace(segment, weight=segment.weight * rows / whole) for segment in thinned]


def levels_passed(parts: Sequence[Recording], range_v: float) -> int:
    """Return the number of equal voltage steps that the recordings resolve, from 1 to `LEVELS`.

    Of a voltage that stands in most rows, the levels count: only the ends of a jump matter to the
    hysteresis. Of one that moves, rows are as far apart as most of its steps are high.
    """
    voltage_v = np.concatenate([part.voltage_v for part in parts])
    steps_v = np.concatenate([np.abs(np.diff(part.voltage_v)) for part in parts])
    if np.mean(steps_v < range_v / LEVELS) >= STANDING_SHARE:
        levels = np.unique(np.round((voltage_v - voltage_v.min()) * (LEVELS / range_v)))
        return int(np.clip(levels.size - 1, 1, LEVELS))
    largest_v = float(np.quantile(steps_v[steps_v > 0.0], LARGE_STEP_SHARE))
    return int(np.clip(round(range_v / largest_v), 1, LEVELS))


def segment_of(
    part: Recording, creep: CreepDynamics, dynamics: ElectricVibrationDynamics, delay_s: float,
) -> HysteresisSegment:
    """Return input and `hysteresis_output_um` of a part of a recording without gaps."""
    used = np.arange(part.time_s.size) >= first_settled(dynamics, part.time_s)
    good = good_samples(part)
    if _answers_in_the_next_row(part, dynamics):
        good = np.append(good[1:], False)
    used &= good
    return HysteresisSegment(
        np.asarray(part.voltage_v, dtype=float),
        hysteresis_output_um(part, creep, dynamics, delay_s),
        np.flatnonzero(used),
        np.exp(-np.outer(part.time_s, creep.zeros_rad_per_s)))


def hysteresis_output_um(
    recording: Recording, creep: CreepDynamics, dynamics: ElectricVibrationDynamics,
    delay_s: float = 0.0,
) -> FloatArray:
    """Return the hysteresis output at each sample, (N,): creep and fast dynamics removed.

    The dynamics are inverted at low frequency by (4.18) and (4.19) if the voltage is slow compared
    with them. The decaying effect of the creep's initial state remains.
    """
    displacement_um = recording.displacement_um
    if dynamics.is_static and delay_s == 0.0:
        return remove_creep(displacement_um, creep, recording.sample_period_s)
    if follows_fast(recording.voltage_v, dynamics, recording.sample_period_s):
        displacement_um = remove_dynamics(
            displacement_um, recording.voltage_v, dynamics, recording.sample_period_s, delay_s)
        return remove_creep(displacement_um, creep, recording.sample_period_s)
    period_s = recording.sample_period_s
    if _answers_in_the_next_row(recording, dynamics):
        # From all rows, because the first shows the initial state of the creep.
        held_um = remove_creep_of_held(displacement_um, creep, period_s)
        # Taking the next row keeps the corners where the voltage turns; a shift along the slope of
        # this one would cut them.
        held_um = np.append(held_um[1:], 2.0 * held_um[-1] - held_um[-2])
        lead_s = delay_s + held_delay_s(dynamics, period_s) - period_s
        return _earlier(held_um, lead_s, period_s)
    lead_s = delay_s
    if _has_means(recording):
        # The hold lags half a sample, the mean leads half a sample less half a clock period.
        lead_s += low_frequency_delay_s(dynamics) + 0.5 / recording.sample_rate_hz
    return remove_creep(_earlier(displacement_um, lead_s, period_s), creep, period_s)


def _earlier(signal: FloatArray, lead_s: float, period_s: float) -> FloatArray:
    """Shift a signal earlier in time by less than a sample period, along its slope."""
    return signal + lead_s * np.gradient(signal, period_s)


def _answers_in_the_next_row(recording: Recording, dynamics: ElectricVibrationDynamics) -> bool:
    """Return whether the displacement of a row is the response to the voltage of the row before.

    It is if rows are read at an instant, and the stage has time to respond between them.
    """
    return not (dynamics.is_static or _has_means(recording) or follows_fast(
        recording.voltage_v, dynamics, recording.sample_period_s))


def _has_means(recording: Recording) -> bool:
    """Return whether displacements are means over several clock samples."""
    return recording.sample_period_s > 1.5 / recording.sample_rate_hz


def _falls(segments: Sequence[HysteresisSegment]) -> bool:
    """Return whether the hysteresis falls when the voltage rises."""
    return sum((segment.voltage_v - segment.voltage_v.mean()) @ segment.output_um
               for segment in segments) < 0.0
