# SPDX-License-Identifier: BSD-3-Clause
"""Preisach density from recordings: the linear dynamics removed, then the estimate."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.creep_removal import (
    remove_creep,
    remove_creep_of_held,
)
from piezo_identification.conditioning.outlier_samples import good_samples
from piezo_identification.conditioning.segments import Recordings, played_segments
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
"""Levels above the lowest voltage, where the voltage passes by so many."""

FEWEST_LEVELS = 4
"""Levels from which a density is sought; fewer show a line only."""

LARGE_STEP_SHARE = 0.9
"""A level is as high as this share of the voltage's changes from sample to sample is at most."""


def estimate_density(
    recording: Recordings, creep: CreepDynamics, dynamics: ElectricVibrationDynamics,
    level_count: int | None = None, cells_per_level: int = 2,
    smoothing_weight: float | None = None, translation_weight: float | None = None,
    delay_s: float = 0.0, most_levels: int = LEVELS, near: DensityEstimate | None = None,
    most_rows: int | None = None,
) -> DensityEstimate:
    """Estimate the Preisach density on a uniform grid over the voltages played.

    Creep and fast dynamics are removed by their inverses, Fig. 4.8. What is left makes a linear
    regression (4.11), solved by smoothed non-negative least squares with all samples; offset and
    initial creep are free. Any input will do: `DensityEstimate.visited` tells which part of the
    plane it determines. Where a line predicts what is held out as well, the hysteresis is a line.

    Parameters
    ----------
    recording : Recording or sequence of Recording
        Of the hysteresis experiment, or any other. For the start see `everett_regression`; after a
        gap a recording starts anew, and several recordings share all but offset and initial creep.
        Samples that are marked as outliers are neither fitted nor held out.
    level_count : int, optional
        Number of levels L above level 0; by default `most_levels`, or as many as the voltage
        passes by.
    cells_per_level : int
        Cells of the model from one level to the next.
    smoothing_weight, translation_weight : float, optional
        Of `smoothed_density`; chosen on branches held out by default.
    delay_s : float
        Of the measurement, beside the dynamics.
    near : DensityEstimate, optional
        From the same recordings beside nearly the same dynamics: the weights are sought from its
        own.
    most_rows : int, optional
        Samples that are fitted, evenly among all; all by default.

    Raises
    ------
    ValueError
        If the voltage does not change or never returns, or the displacement falls where the
        voltage rises.
    """
    parts = played_segments(recording)
    segments = [segment_of(part, creep, dynamics, delay_s) for part in parts]
    if most_rows is not None:
        every = -(-sum(segment.samples.size for segment in segments) // most_rows)
        segments = [replace(segment, samples=segment.samples[::every]) for segment in segments]
    _check_sign(parts[0].path, segments)
    return density_of_parts(parts, segments, level_count, cells_per_level, smoothing_weight,
                            translation_weight, most_levels, near)


def density_of_parts(
    parts: Sequence[Recording], segments: Sequence[HysteresisSegment],
    level_count: int | None = None, cells_per_level: int = 2,
    smoothing_weight: float | None = None, translation_weight: float | None = None,
    most_levels: int = LEVELS, near: DensityEstimate | None = None,
) -> DensityEstimate:
    """Estimate the density from what enters and leaves the hysteresis in parts of recordings.

    Parameters
    ----------
    parts : sequence of Recording
        Without gaps.
    segments : sequence of HysteresisSegment
        One for each.
    level_count, cells_per_level, smoothing_weight, translation_weight, most_levels, near
        As of `estimate_density`.

    Raises
    ------
    ValueError
        If the voltage does not change or never returns.
    """
    lowest_v = min(part.voltage_v.min() for part in parts)
    highest_v = max(part.voltage_v.max() for part in parts)
    if lowest_v == highest_v:
        raise ValueError(
            f"the voltage of {parts[0].path} is {lowest_v:g} V throughout: give a recording in "
            "which it moves")
    passed = levels_passed(parts, highest_v - lowest_v)
    is_line = passed < FEWEST_LEVELS
    if level_count is None:
        level_count = max(min(passed, most_levels), FEWEST_LEVELS)
    edges_v = np.linspace(lowest_v, highest_v, level_count * cells_per_level + 1)
    return density_of_segments(
        segments, edges_v, level_count, smoothing_weight, translation_weight, is_line, near)


def levels_passed(parts: Sequence[Recording], range_v: float) -> int:
    """Count the equal steps of voltage that the recordings do not jump over.

    Returns
    -------
    int
        From 1 to `LEVELS`.
    """
    steps_v = np.concatenate([np.abs(np.diff(part.voltage_v)) for part in parts])
    largest_v = float(np.quantile(steps_v[steps_v > 0.0], LARGE_STEP_SHARE))
    return int(np.clip(round(range_v / largest_v), 1, LEVELS))


def segment_of(
    part: Recording, creep: CreepDynamics, dynamics: ElectricVibrationDynamics, delay_s: float,
) -> HysteresisSegment:
    """Return what enters and leaves the hysteresis in a part of a recording without gaps.

    Parameters
    ----------
    creep, dynamics, delay_s
        See `hysteresis_output_um`.
    """
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
    """Hysteresis output at each sample: creep, electric and vibration dynamics removed.

    Parameters
    ----------
    dynamics : ElectricVibrationDynamics
        Inverted at low frequency, (4.18) and (4.19), where the voltage is slow beside it.
    delay_s : float
        Further delay.

    Returns
    -------
    ndarray, shape (N,)
        But for the decaying trace of the creep's initial state.
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
        # Of all rows, as the first shows where the creep begins.
        held_um = remove_creep_of_held(displacement_um, creep, period_s)
        # The next row keeps the corners where the voltage turns; a shift along the slope of this
        # one would cut them.
        held_um = np.append(held_um[1:], 2.0 * held_um[-1] - held_um[-2])
        lead_s = delay_s + held_delay_s(dynamics, period_s) - period_s
        return _earlier(held_um, lead_s, period_s)
    lead_s = delay_s
    if _has_means(recording):
        # The hold lags half a sample, the mean leads half a sample less half a clock period.
        lead_s += low_frequency_delay_s(dynamics) + 0.5 / recording.sample_rate_hz
    return remove_creep(_earlier(displacement_um, lead_s, period_s), creep, period_s)


def _earlier(signal: FloatArray, lead_s: float, period_s: float) -> FloatArray:
    """Move a signal ahead in time by less than a sample period, along its slope."""
    return signal + lead_s * np.gradient(signal, period_s)


def _answers_in_the_next_row(recording: Recording, dynamics: ElectricVibrationDynamics) -> bool:
    """Tell whether the displacement of a row is the answer to the voltage of the row before.

    It is where rows are read at an instant, and the stage has time to answer between them.
    """
    return not (dynamics.is_static or _has_means(recording) or follows_fast(
        recording.voltage_v, dynamics, recording.sample_period_s))


def _has_means(recording: Recording) -> bool:
    """Tell whether displacements are means over several samples of the clock."""
    return recording.sample_period_s > 1.5 / recording.sample_rate_hz


def _check_sign(path: str, segments: Sequence[HysteresisSegment]) -> None:
    """Refuse a hysteresis that falls where the voltage rises, the dynamics removed."""
    products = [(segment.voltage_v - segment.voltage_v.mean()) @ segment.output_um
                for segment in segments]
    if sum(products) < 0.0:
        raise ValueError(f"{path}: the displacement falls where the voltage rises: "
                         "reverse the sign of one")
