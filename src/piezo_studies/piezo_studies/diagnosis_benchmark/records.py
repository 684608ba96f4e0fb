# SPDX-License-Identifier: BSD-3-Clause
"""Recordings of a plant: the designed experiments, and other common laboratory inputs."""

import itertools
from dataclasses import replace

import numpy as np

from piezo_identification.experiments import catalogue as experiments
from piezo_identification.experiments.catalogue import Experiment, StageLimits
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag
from piezo_sim.plant.plant_effect import Surroundings
from piezo_studies.diagnosis_benchmark.effect_draws import respond

REST_V = 0.0
RAMP_S = 0.1
FAST_HZ, SLOW_HZ = 40_000.0, 1000.0
"""Sample rates of fast experiments, and of a logger for slow ones."""
LEAST_CLOCK_HZ = 10_000.0
"""Lowest clock rate of a stage, whatever the logger, so that motion between its samples acts."""

STAGE_LIMITS = StageLimits(0.0, 100.0, 1.8e6)
"""Limits of a stage for proposed experiments."""

LOWEST_V, LEVELS_SPAN_V = 5.0, 90.0
MOST_CHANGE_V = 45.0
"""Largest change between levels; the stage node allows 50 V."""


def designed(random, slow):
    """Return the validation experiment; for a slow logger, steps held for seconds."""
    if slow:
        levels_v = 50.0 + 0.5 * random.uniform(-60.0, 60.0, 7)
        return _held("steps", levels_v, 4.0, SLOW_HZ)
    return experiments.validation(arc_s=0.05, tones_s=0.3)


def sweep(random, slow):
    """Return a sine whose frequency rises over two decades or more."""
    rate_hz, duration_s = (SLOW_HZ, 28.0) if slow else (FAST_HZ, 0.8)
    first_hz, last_hz = (0.1, 30.0) if slow else (5.0, random.uniform(600.0, 1500.0))
    time_s = np.arange(round(duration_s * rate_hz)) / rate_hz
    ratio = np.log(last_hz / first_hz)
    phase = 2.0 * np.pi * first_hz * duration_s / ratio * np.expm1(ratio * time_s / duration_s)
    frequency_hz = first_hz * np.exp(ratio * time_s / duration_s)
    amplitude_v = random.uniform(20.0, 35.0) / (1.0 + frequency_hz / 300.0)
    return Experiment("sweep", 50.0 - amplitude_v * np.cos(phase), 1.0 / rate_hz, 1, "")


def random_levels(random, slow):
    """Draw levels, each held for the same time; their distance is limited."""
    changes_v = random.uniform(-MOST_CHANGE_V, MOST_CHANGE_V, 56 if slow else 80)
    levels_v = LOWEST_V + _folded(LEVELS_SPAN_V, np.cumsum(changes_v))
    return _held("random_levels", levels_v, 0.5 if slow else 0.01, SLOW_HZ if slow else FAST_HZ)


def tracking(random, slow):
    """Return a typical voltage in operation: a scan line with a superposed sine."""
    rate_hz, duration_s = (SLOW_HZ, 28.0) if slow else (FAST_HZ, 0.8)
    time_s = np.arange(round(duration_s * rate_hz)) / rate_hz
    line_hz = random.uniform(0.2, 1.0) if slow else random.uniform(6.0, 20.0)
    middle_v, reach_v = random.uniform(40.0, 60.0), random.uniform(20.0, 38.0)
    position = line_hz * time_s % 1.0
    triangle = 4.0 * np.abs(position - 0.5) - 1.0
    # A controller rounds the corners.
    line = triangle if slow else np.sin(0.5 * np.pi * triangle)
    fast_hz = line_hz * random.uniform(4.0, 12.0)
    voltage_v = middle_v + reach_v * line + 0.15 * reach_v * np.sin(2.0 * np.pi * fast_hz * time_s)
    return Experiment("tracking", voltage_v, 1.0 / rate_hz, 1, "")


def _folded(span, values):
    """Return the values reflected at 0 and at the span, so that they lie between."""
    return span - np.abs(values % (2.0 * span) - span)


KINDS = {"designed": designed, "sweep": sweep, "random_levels": random_levels, "tracking": tracking}


def identification_experiments():
    """Return the designed experiments for the identification, shorter than usual."""
    limits = StageLimits(sample_rate_hz=SLOW_HZ)
    return {
        "creep": experiments.creep(replace(limits, sample_rate_hz=100.0)),
        "dynamics": experiments.dynamics(duration_s=1.0),
        "hysteresis": experiments.hysteresis(limits, level_count=50, harmonic_period_s=1.0),
    }


def _held(name, levels_v, hold_s, rate_hz):
    return Experiment(name, np.repeat(levels_v, round(hold_s * rate_hz)), 1.0 / rate_hz, 1, "")


def commanded(experiment):
    """Return the voltage with ramps from and to rest, (N,), and the flags of each sample."""
    waveform_v = np.tile(experiment.voltage_v, experiment.repeats)
    samples = round(RAMP_S / experiment.sample_period_s)
    ramp = np.arange(1, samples + 1) / samples
    first_v, last_v = waveform_v[0], waveform_v[-1]
    voltage_v = np.concatenate([
        REST_V + ramp * (first_v - REST_V), waveform_v, last_v + ramp * (REST_V - last_v)
    ])
    flags = np.full(voltage_v.size, Flag.RAMPING, dtype=np.uint32)
    flags[samples : samples + waveform_v.size] = Flag.PLAYING
    return voltage_v, flags


def surroundings(experiment, seed):
    """Return the surroundings of a plant whose sample clock has the period of the experiment."""
    return Surroundings(experiment.sample_period_s, REST_V, seed)


def clock_samples(experiment):
    """Return the samples of the stage's clock for each sample of the experiment."""
    return max(1, round(LEAST_CLOCK_HZ * experiment.sample_period_s))


def record(plant, experiment, seed):
    """Play an experiment from rest, and return the recording."""
    voltage_v, flags = commanded(experiment)
    measured_um = respond(
        plant, voltage_v, surroundings(experiment, seed), clock_samples(experiment))
    period_s = experiment.sample_period_s
    return Recording(
        path=experiment.name, sample_rate_hz=1.0 / period_s,
        sample_index=np.arange(voltage_v.size),
        sample_periods_s=np.full(voltage_v.size, period_s),
        voltage_v=voltage_v, displacement_um=measured_um, flags=flags,
    )


def play_proposed(plant, experiment, seed):
    """Play a proposed experiment like the stage: at its clock, with means over held values."""
    clock_hz = STAGE_LIMITS.sample_rate_hz
    held = round(experiment.sample_period_s * clock_hz)
    voltage_v, flags = commanded(experiment)
    clock = Surroundings(1.0 / clock_hz, REST_V, seed)
    measured_um = respond(plant, np.repeat(voltage_v, held), clock, 1)
    return Recording(
        experiment.name, clock_hz, held * np.arange(voltage_v.size),
        np.full(voltage_v.size, experiment.sample_period_s), voltage_v,
        measured_um.reshape(-1, held).mean(axis=1), flags)


def player_of_proposals(plant, seed):
    """Return a function that plays proposed experiments on a plant; see `decide.decide`.

    The seed is that of the previous recording; each further recording uses the next one.
    """
    seeds = itertools.count(seed + 1)
    return lambda proposal, progress: play_proposed(plant, proposal.experiment, next(seeds))
