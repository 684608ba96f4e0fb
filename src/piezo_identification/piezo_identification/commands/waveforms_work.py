# SPDX-License-Identifier: BSD-3-Clause
"""The work of `waveforms`: write the experiments as tables of time and voltage."""

import argparse
import math

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_common.command_line import print_next
from piezo_identification.commands.waveforms_command import waveform_paths
from piezo_identification.experiments.catalogue import Experiment, named_experiment
from piezo_identification.experiments.input_designs import arc
from piezo_identification.experiments.stage_limits import StageLimits

SLOW_PERIODS_S = {"creep": 0.01, "hysteresis": 0.001, "sweep": 0.001}
"""Shortest time (s) for which an experiment holds a value."""
REST_ROWS = 20
"""Rows at rest before and after an experiment; `check` finds from them that the stage rested."""
SWEEP_ARC_S, SWEEPS = 2.0, 2


def write_waveforms(options: argparse.Namespace) -> None:
    """Write a file for each selected experiment.

    Raises
    ------
    ValueError
        If an experiment does not fit the range, the rate or the slew limit.
    """
    lowest_v, highest_v = options.range
    rest_v = options.rest
    if rest_v is None:
        rest_v = min(max(0.0, lowest_v), highest_v)
    limits = StageLimits(lowest_v, highest_v, options.slew_limit, options.rate, rest_v)
    experiments = [_experiment(name, limits, options.levels) for name in options.experiments]
    options.directory.mkdir(parents=True, exist_ok=True)
    for experiment, path in zip(experiments, waveform_paths(options).values(), strict=True):
        rest = np.full(REST_ROWS, rest_v)
        voltage_v = np.concatenate([rest, with_ramps(experiment, rest_v, options.ramp_rate), rest])
        time_s = np.arange(voltage_v.size) * experiment.sample_period_s
        np.savetxt(path, np.column_stack([time_s, voltage_v]), ("%.9g", "%.7g"), ",",
                   header="time_s,voltage_v", comments="")
        print(f"{path}: {voltage_v.size} samples of {1e3 * experiment.sample_period_s:g} ms, "
              f"{voltage_v.size * experiment.sample_period_s:.4g} s, {experiment.description}")
    print_next(options, "piezo_identification", "check", "--data",
               "<a recording of one, with the column displacement_um>")


def with_ramps(experiment: Experiment, rest_v: float, ramp_v_per_s: float) -> FloatArray:
    """Return all values of an experiment, with ramps from rest and back to it, shape (N,)."""
    played_v = np.tile(experiment.voltage_v, experiment.repeats)
    step_v = ramp_v_per_s * experiment.sample_period_s

    def way(start_v: float, end_v: float) -> FloatArray:
        return np.linspace(start_v, end_v, math.ceil(abs(end_v - start_v) / step_v) + 1)

    return np.concatenate([way(rest_v, played_v[0])[:-1], played_v,
                           way(played_v[-1], rest_v)[1:], [rest_v]])


def sweep(limits: StageLimits, sample_period_s: float) -> Experiment:
    """Return slow arcs over the whole range, which leave the hysteresis in a known state."""
    samples = round(SWEEP_ARC_S / sample_period_s)
    once = np.concatenate([arc(0.0, 1.0, samples), arc(1.0, 0.0, samples)])
    return Experiment("sweep", limits.voltage_min_v + limits.span_v * once, sample_period_s,
                      SWEEPS, "over the whole range and back, before the recordings")


def _experiment(name: str, limits: StageLimits, levels: int | None) -> Experiment:
    parameters: dict[str, float] = {}
    if name in SLOW_PERIODS_S:
        samples = max(1, round(SLOW_PERIODS_S[name] * limits.sample_rate_hz))
        parameters["sample_period_s"] = samples / limits.sample_rate_hz
    if name == "hysteresis" and levels is not None:
        parameters["level_count"] = levels
    if name == "sweep":
        return sweep(limits, parameters["sample_period_s"])
    experiment = named_experiment(name, limits, parameters)
    assert isinstance(experiment, Experiment)  # experiments in feedback are not offered
    return experiment
