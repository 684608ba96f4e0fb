# SPDX-License-Identifier: BSD-3-Clause
"""Hysteresis estimated from all of its recordings, of stages that were cycled before or not."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from piezo_identification.conditioning.sensor_noise import noise_floor_um
from piezo_identification.conditioning.waveforms import played
from piezo_identification.estimators.hysteresis.density_estimate import (
    LINE_OF_RESPONSE,
    DensityEstimate,
)
from piezo_identification.estimators.hysteresis.density_fit import (
    density_of_parts,
    estimate_density,
    hysteresis_output_um,
)
from piezo_identification.estimators.hysteresis.dynamics_inverse import input_of, samples_added
from piezo_identification.estimators.hysteresis.equations import HysteresisSegment
from piezo_identification.estimators.hysteresis.first_rise_fit import (
    LARGEST_ERROR_RATIO,
    estimate_first_rise,
    highest_before,
    without_first_rise,
)
from piezo_identification.fitting.regression import SETTINGS as FIT
from piezo_identification.identification.given_data import (
    Data,
    keys_of_kind,
    of_kind,
    with_straight_voltages,
)
from piezo_identification.identification.linear_dynamics import LinearDynamics, fitted_model
from piezo_identification.simulation.past_search import after_saturation, simulated_recording
from piezo_identification.simulation.simulated_recording import PastVoltages, SimulatedRecording
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.first_rise import FirstRise
from piezo_recorder.reading.recording import Recording

ANY_VOLTAGE_V = 1000.0
"""Limit above the voltage of piezo amplifiers. The voltages of a response are unknown, so its line
is valid between minus and plus this voltage."""

MOST_NOISE = 0.9
"""Largest part of the residual with a remanence that may count as noise. Even if the residual is
only noise, it must then be a fifth smaller than that without the remanence."""


@dataclass(frozen=True)
class DensityOptions:
    """Options for the density of the hysteresis; what is None is chosen from the data."""

    grid: int | None = None
    """Number of cells along each threshold."""
    smoothing_weight: float | None = None
    translation_weight: float | None = None
    """As in `piezo_identification.estimators.hysteresis.smoothed_density.density_of_segments`."""

    def __post_init__(self) -> None:
        if self.grid is not None and not 4 <= self.grid <= 300:
            raise ValueError(f"grid is {self.grid}: give 4 to 300")
        for name in ("smoothing_weight", "translation_weight"):
            weight = getattr(self, name)
            if weight is not None and not 0.0 <= weight < np.inf:
                raise ValueError(f"{name} is {weight:g}: give a number from 0 up")

    def keywords(self) -> dict[str, Any]:
        """Return the options as arguments of `density_fit.estimate_density`."""
        return {"level_count": self.grid, "cells_per_level": 2 if self.grid is None else 1,
                "smoothing_weight": self.smoothing_weight,
                "translation_weight": self.translation_weight or 0.0}


CHOSEN_BY_DATA = DensityOptions()


def estimate_hysteresis_of(
    recordings: Mapping[str, Data], linear: LinearDynamics,
    options: DensityOptions = CHOSEN_BY_DATA,
) -> DensityEstimate:
    """Estimate the hysteresis from its recordings, or from all others if there are none.

    The recordings have no gaps. For a response alone, it is a line through 0 V with its gain.
    """
    shown = of_kind(recordings, "hysteresis") or [
        data for name in ("creep", "dynamics") for data in of_kind(recordings, name)
        if isinstance(data, Recording)]
    if not shown:
        return _line_of_response(linear)
    return estimate_density(
        shown, linear.creep, linear.slow_dynamics, delay_s=linear.slow_delay_s,
        **options.keywords())


def _line_of_response(linear: LinearDynamics) -> DensityEstimate:
    # Of a sensor that counts the other way, the model's displacement rises with the voltage.
    gain = abs(float(linear.estimates["dynamics"].model.gain))
    return DensityEstimate(
        LINE_OF_RESPONSE, np.array([-ANY_VOLTAGE_V, ANY_VOLTAGE_V]), np.zeros((1, 1)),
        -gain * ANY_VOLTAGE_V, np.ones((1, 1), dtype=bool),
        reversible_um_per_v=np.array([gain]))


def estimate_loops(
    recordings: Mapping[str, Any], linear: LinearDynamics, options: DensityOptions,
) -> tuple[DensityEstimate, FirstRise | None, Mapping[str, Data]]:
    """Estimate the density, and the first-cycle remanence if a recording shows it.

    The remanence is None unless it fits a recording of loops or creep far better, and all of them
    together no worse: loops alone may explain it by the remainder of earlier creep. The returned
    recordings are as if the stage had been cycled before each of them.
    """
    density = estimate_hysteresis_of(recordings, linear, options)
    found = loops_with_first_rise(recordings, linear, options)
    if found is None:
        return density, None, recordings
    cycled_density, first_rise, cycled = found
    keys = [name for kind in ("hysteresis", "creep") for name in keys_of_kind(recordings, kind)]
    without, within = (
        {name: after_saturation(fitted_model(linear, estimate, rise).model, recordings[name])
         for name in keys}
        for estimate, rise in ((density, None), (cycled_density, first_rise)))
    without_um, with_um = (
        np.linalg.norm([run.error_um() for run in runs.values()]) for runs in (without, within))
    if with_um > without_um or not any(
            _is_far_better(within[name], without[name].error_um()) for name in keys):
        return density, None, recordings
    return cycled_density, first_rise, cycled


def loops_with_first_rise(
    recordings: Mapping[str, Any], linear: LinearDynamics, options: DensityOptions,
) -> tuple[DensityEstimate, FirstRise, Mapping[str, Data]] | None:
    """Return what `estimate_loops` does, with the largest first rise that loops seem to show.

    None if they show none.
    """
    shown = _shown_first_rises(recordings, linear)
    if not shown:
        return None
    key = max(shown, key=lambda name: shown[name].whole_um)
    cycled = _as_cycled(recordings, key, shown, linear, options)
    return estimate_hysteresis_of(cycled, linear, options), shown[key], cycled


def _is_far_better(run: SimulatedRecording, without_um: float) -> bool:
    """Return whether the error of a run beyond its noise is far smaller than another error."""
    residual_um = run.error_um()
    noise_um = min(
        noise_floor_um(run.measured_um[run.settled] - run.fitted_um()),
        MOST_NOISE * residual_um)
    beyond_um, without_beyond_um = np.sqrt(np.maximum(
        np.square([residual_um, without_um]) - noise_um**2, 0.0))
    return bool(beyond_um <= LARGEST_ERROR_RATIO * without_beyond_um)


def _shown_first_rises(
    recordings: Mapping[str, Any], linear: LinearDynamics,
) -> dict[str, FirstRise]:
    """Return the first rise of each recording that shows one, by the recording's key."""
    shown = {}
    for name in keys_of_kind(recordings, "hysteresis"):
        part = played(recordings[name])
        found = estimate_first_rise(
            np.asarray(part.voltage_v, dtype=float),
            hysteresis_output_um(part, linear.creep, linear.slow_dynamics, linear.slow_delay_s),
            highest_before(recordings[name]))
        if found is not None:
            shown[name] = found
    return shown


def _as_cycled(
    recordings: Mapping[str, Any], key: str, shown: Mapping[str, FirstRise],
    linear: LinearDynamics, options: DensityOptions,
) -> dict[str, Data]:
    """Return the recordings as if made with a cycled stage, using the first rise of one of them.

    If a recording shows no first rise of its own, the voltage that the stage had reached before is
    the one that fits its loops best.
    """
    cycled = dict(recordings)

    def correct(name: str, highest_v: float | None = None) -> None:
        cycled[name] = without_first_rise(
            recordings[name], shown[key], linear.creep, linear.slow_dynamics, highest_v)

    for name in shown:
        correct(name)
    others = [name for name in keys_of_kind(recordings, "hysteresis") if name not in shown]
    if others:
        loops = {name: cycled[name] for name in shown}
        model = fitted_model(
            linear, estimate_hysteresis_of(loops, linear, options), shown[key]).model
        for name in others:
            highest_v = after_saturation(model, recordings[name]).highest_v
            if highest_v < shown[key].voltages_v[-1]:
                correct(name, highest_v)
    return cycled


def new_loops(
    recordings: Mapping[str, Any], options: DensityOptions, model: StageModel,
    read_late_s: Mapping[str, float], straight: Collection[str] = (),
    pasts_v: Mapping[str, PastVoltages] | None = None, is_of_plays: bool = False,
) -> DensityEstimate:
    """Estimate the hysteresis again from the residuals of a fitted model.

    Only the residual passes through the inverse of the model's linear part. It is then added to the
    output of the model's hysteresis.

    The recordings have their rows as given, not aligned, and each reads its rows `read_late_s`
    after the voltage; the voltages of those in `straight` are straight between their rows, not
    held. The pasts that are not given are those that the model fits best. `is_of_plays` tells
    whether the last estimate was a density about a sum of plays.
    """
    pasts_v = pasts_v or {}
    given = with_straight_voltages(recordings, straight)
    simulated = [
        simulated_recording(model, each, pasts_v.get(name), read_late_s[name])
        for kind in ("hysteresis", "dynamics")
        for name, each in zip(keys_of_kind(recordings, kind), of_kind(given, kind), strict=True)
        if isinstance(each, Recording)]
    return density_of_parts([each.part for each in simulated], _weighed(
        list(map(_loops_again, simulated))), is_of_plays=is_of_plays, **options.keywords())


def _weighed(segments: Sequence[tuple[HysteresisSegment, float]]) -> list[HysteresisSegment]:
    """Give each recording the weight that it has in the fit of the whole model.

    Each segment comes with the mean square error of its recording, in um^2, not 0.
    """
    rows = np.array([segment.samples.size for segment, _ in segments])
    of_row = 1.0 / (rows * [square_um2 for _, square_um2 in segments])
    of_row *= rows.sum() / (rows @ of_row)
    return [replace(segment, weight=float(weight))
            for (segment, _), weight in zip(segments, of_row, strict=True)]


def _loops_again(simulated: SimulatedRecording) -> tuple[HysteresisSegment, float]:
    """Return the input of the model's hysteresis, and the output that the residual asks for.

    The mean square of what the residual asks for follows, in um^2, at least that of a good model.
    """
    residual_um = simulated.measured_um - simulated.simulate()
    count = residual_um.size + samples_added(residual_um.size)
    lines = np.asarray(np.fft.rfftfreq(count), dtype=float)
    missing_um = input_of(residual_um, simulated.linear_response(lines))
    entering_v, output_um = simulated.loops()
    segment = HysteresisSegment(
        entering_v, output_um + missing_um, simulated.good,
        np.exp(-np.outer(simulated.time_s, simulated.model.creep.zeros_rad_per_s)))
    others = np.column_stack([np.ones(missing_um.size), segment.transients])[simulated.good]
    asked_um = missing_um[simulated.good]
    asked_um = asked_um - others @ np.linalg.lstsq(others, asked_um, rcond=None)[0]
    accuracy_um = FIT.model_tolerance * np.ptp(simulated.measured_um)
    return segment, float(np.mean(asked_um**2) + accuracy_um**2)
