# SPDX-License-Identifier: BSD-3-Clause
"""Search for the voltages before a recording, which its simulation depends on."""

from dataclasses import dataclass
from itertools import product

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.outlier_samples import with_outliers_marked
from piezo_identification.conditioning.sensor_sign import reversed_displacement
from piezo_identification.conditioning.settling import first_settled
from piezo_identification.conditioning.waveforms import played
from piezo_identification.simulation.simulated_recording import PastVoltages, SimulatedRecording
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.pasts import demagnetising_v
from piezo_recorder.reading.recording import Recording

FEWEST_SAMPLES = 100
"""Fewest samples of a recording that is fitted: a third is held out, and a dozen effects are
fitted."""

NEAR_THE_END = 1e-3
"""Distance from an end of the voltage range at which it counts as reached, as a fraction of the
range."""


@dataclass(frozen=True)
class PastSearchSettings:
    """Settings of the search for the voltages before a recording."""

    compared_samples: int = 200_000
    """Samples at the start of the recording on which the errors with and without a past are
    compared."""
    fewest_samples: int = 50_000
    """Fewest samples at the start of the recording that are simulated for each candidate."""
    until_forgotten: float = 2.0
    """Length of the start that is simulated for each candidate, relative to that after which the
    voltage has reached both its extremes. Later loops are congruent after all pasts (Mayergoyz
    1986), so that they only show the offset."""
    grid_points: int = 6
    """Number of highest and of lowest voltages tried in each round."""
    rounds: int = 3
    """Number of grids, each around the best candidate of the one before. Three grids of six points
    resolve a hundredth of the voltage range, and six a thousandth."""
    largest_error_ratio: float = 0.9
    """Largest ratio of the errors with and without a past for which the past is accepted. Two more
    parameters always reduce the error a little."""


SETTINGS = PastSearchSettings()


def conditioned(model: StageModel, recording: Recording) -> tuple[Recording, bool]:
    """Return the recording with the sign of the model and with its outliers marked.

    The second result is whether the sign of its displacement was changed. Raise ValueError if the
    recording has gaps, or is too short to settle.
    """
    recording = with_outliers_marked(recording)
    is_reversed = after_saturation(model, recording).is_reversed
    return (reversed_displacement(recording) if is_reversed else recording), is_reversed


def starting_past_v(model: StageModel, recording: Recording) -> PastVoltages:
    """Estimate the voltages before a recording, as far as the recording depends on them.

    Unless the hysteresis is saturated at the start, a recording depends on its past. Two pasts are
    fitted: the highest and then the lowest earlier voltage, which represent the first turning
    points of any past, and swings that became smaller about some voltage, which leave the stage
    demagnetised. The better one is used if the error is clearly smaller than with a past from
    negative saturation. The result is the extreme voltages in their order, and empty if they are
    not used.
    """
    part = after_saturation(model, _start_of(recording, SETTINGS.compared_samples))
    if not model.has_hysteresis or _starts_saturated(part):
        return ()
    samples = _samples_with_past(part.voltage_v)
    start = part if samples >= part.time_s.size else after_saturation(
        model, _start_of(recording, samples))
    pasts_v: list[PastVoltages] = [_closest_past_v(start)]
    if not model.hysteresis.is_line:
        pasts_v.append(_closest_demagnetised_v(start))
    closest = min(map(part.after, pasts_v), key=SimulatedRecording.error_um)
    explains_more = closest.error_um() < SETTINGS.largest_error_ratio * part.error_um()
    return closest.past_v if explains_more else ()


def _start_of(recording: Recording, samples: int) -> Recording:
    return recording.select(np.cumsum(recording.playing | recording.tracking) <= samples)


def _samples_with_past(voltage_v: FloatArray) -> int:
    """Return the number of samples that show the voltages before them best."""
    near_v = NEAR_THE_END * np.ptp(voltage_v)
    both = max(int(np.argmax(voltage_v >= voltage_v.max() - near_v)),
               int(np.argmax(voltage_v <= voltage_v.min() + near_v)))
    return max(SETTINGS.fewest_samples, round(SETTINGS.until_forgotten * both))


def after_saturation(model: StageModel, recording: Recording) -> SimulatedRecording:
    """Simulate a recording after negative saturation.

    For a model with a first rise, the highest earlier voltage is estimated: the stage was cycled,
    unless a lower voltage reduces the error clearly. Raise ValueError if the recording has gaps, or
    is too short to settle.
    """
    cycled = SimulatedRecording(model, recording)
    if model.first_rise is None:
        return cycled
    candidates = np.linspace(
        model.first_rise.voltages_v[0], model.first_rise.voltages_v[-1], SETTINGS.grid_points)
    closest = min((cycled.after((), float(highest_v)) for highest_v in candidates),
                  key=SimulatedRecording.error_um)
    explains_more = closest.error_um() < SETTINGS.largest_error_ratio * cycled.error_um()
    return closest if explains_more else cycled


def simulated_recording(model: StageModel, recording: Recording,
                        past_v: PastVoltages | None = None,
                        read_late_s: float = 0.0) -> SimulatedRecording:
    """Simulate a recording that is to be fitted, after the voltages before it.

    The recording has the sign of the model and marked outliers. The voltages before it are those of
    `starting_past_v` unless they are given. The displacement of a row is read `read_late_s` after
    its voltage, 0 for means. Raise ValueError if the recording has gaps, or is too short.
    """
    part = after_saturation(model, recording)
    if part.settled.size < FEWEST_SAMPLES:
        raise ValueError(
            f"{part.path} has {part.time_s.size} samples, fewer than {FEWEST_SAMPLES} after the "
            "start has settled: record longer")
    past_v = starting_past_v(model, recording) if past_v is None else past_v
    return part.after(past_v).read_at(read_late_s)


def is_long_enough(model: StageModel, recording: Recording) -> bool:
    """Tell whether a recording has the samples that it needs, once its start has settled."""
    time_s = played(recording).time_s
    settled = first_settled(model.dynamics, time_s, model.effects)
    return bool(time_s.size - settled >= FEWEST_SAMPLES)


def _starts_saturated(part: SimulatedRecording) -> bool:
    """Tell whether the voltage is at an end of the model's range at or before the first sample."""
    hysteresis, before_v = part.model.hysteresis, part.earlier_v
    if hysteresis.is_line:  # that of an effect is at rest at first, wherever the voltage is
        return False
    near_v = NEAR_THE_END * (hysteresis.voltage_max_v - hysteresis.voltage_min_v)
    return bool(np.any((before_v <= hysteresis.voltage_min_v + near_v)
                       | (before_v >= hysteresis.voltage_max_v - near_v)))


def _closest_demagnetised_v(part: SimulatedRecording) -> PastVoltages:
    """Find the swings about the first or another voltage with the smallest error."""
    hysteresis = part.model.hysteresis
    low_v, high_v = hysteresis.voltage_min_v, hysteresis.voltage_max_v

    def swings_v(centre_v: float) -> PastVoltages:
        return tuple(demagnetising_v(centre_v, low_v, high_v).tolist())

    def error_um(centre_v: float) -> float:
        return part.after(swings_v(centre_v)).error_um()

    best_v = float(np.clip(part.earlier_v[0], low_v, high_v))
    spacing_v = (high_v - low_v) / (SETTINGS.grid_points + 1)
    candidates_v = low_v + spacing_v * np.arange(1, SETTINGS.grid_points + 1)
    for _ in range(SETTINGS.rounds):
        best_v = min([best_v, *candidates_v.tolist()], key=error_um)
        candidates_v = np.clip(best_v + spacing_v * np.linspace(
            -1.0, 1.0, SETTINGS.grid_points), low_v, high_v)
        spacing_v /= SETTINGS.grid_points
    return swings_v(best_v)


def _closest_past_v(part: SimulatedRecording) -> tuple[float, float]:
    """Find the highest and then the lowest earlier voltage with the smallest error.

    A hysteresis by an equation of first order remembers one number, so that the highest voltage is
    that of the range, and twice as many grids cost less.
    """
    hysteresis, first_v = part.model.hysteresis, part.earlier_v[0]
    highest_v = max(first_v, hysteresis.voltage_max_v)
    bounds_v = np.array([[highest_v if hysteresis.is_line else first_v, highest_v],
                         [min(first_v, hysteresis.voltage_min_v), first_v]])
    for _ in range(SETTINGS.rounds * (2 if hysteresis.is_line else 1)):
        candidates = list(product(*(
            np.unique(np.linspace(low_v, high_v, SETTINGS.grid_points))
            for low_v, high_v in bounds_v)))
        best_v = min(candidates, key=lambda past_v: part.after(past_v).error_um())
        spacing_v = np.diff(bounds_v).ravel() / (SETTINGS.grid_points - 1)
        around_v = np.array(best_v)[:, None] + np.outer(spacing_v, [-1.0, 1.0])
        bounds_v = np.clip(around_v, bounds_v[:, :1], bounds_v[:, 1:])
    highest_v, lowest_v = best_v
    return float(highest_v), float(lowest_v)
