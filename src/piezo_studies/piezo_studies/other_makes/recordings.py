# SPDX-License-Identifier: BSD-3-Clause
"""Recordings of a make by the recipe for laboratories, and three unseen motions.

Every recording is a table `time_s,voltage_v,displacement_um`. Before it, the stage is swept over
its range and rests.
"""

import json
import zlib
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.commands.waveforms_work import sweep, with_ramps
from piezo_identification.experiments.catalogue import (
    VALIDATION_TURNS,
    Experiment,
    creep,
    dynamics,
    hysteresis,
    multisine,
    validation,
)
from piezo_models.measures import e_y_percent
from piezo_studies.other_makes.linear_system import HeldVoltage
from piezo_studies.other_makes.makes import Make

IDENTIFICATION, UNSEEN = ("creep", "dynamics", "hysteresis"), ("slow", "fast", "mixed")
KNOWN = "known.json"
"""File in the folder of the tables with true values of the make and of its recordings."""

CREEP_ROW_S, SLOW_ROW_S, REST_S, RAMP_S = 0.01, 0.001, 60.0, 0.1
"""Periods of slow rows, duration of the rest, and duration of a ramp over the range (s)."""

LEVELS = 20
PERIODS_OF_MODE, SQUARE_WAVES, DYNAMICS_S = 24.0, 100, 1.5
"""Periods of the first mode in a period of the square wave, fewest periods of the square wave, and
its shortest duration."""

CHIRP_S, CHIRP_HZ, CHIRP_SWING = 4.0, (10.0, 12e3), 0.02
TONES = (0.11, 0.23, 0.37, 0.53, 0.71, 0.86, 1.0)
"""Frequencies of the unseen tones relative to that of the first mode."""

TONE_SWING, MIXED_SWING = 0.025, 0.01
"""Amplitude of each tone in the displacement, as a fraction of the range."""

TRIANGLE_S, SLOW_SINES_S = 1.0, 12.0
SLOW_SINES = ((0.17, 0.16, 0.0), (0.43, 0.12, 1.0), (1.1, 0.08, 2.0), (2.3, 0.04, 3.0))
"""Frequency (Hz), amplitude as a fraction of the range, and phase of each slow sine."""


@dataclass(frozen=True)
class Known:
    """True values of a recording that are unknown in a laboratory."""

    noise_percent: float
    """Noise and drift of the sensor relative to the displacement, in percent like e_y (4.20)."""
    counted_s: tuple[float, float]
    """Beginning and end of the unseen motion, without ramps, in which the error is computed."""


def record(make: Make, folder: Path, seed: int) -> None:
    """Write the tables of a make and their true values, unless the folder already has them."""
    if (folder / KNOWN).exists():
        return
    folder.mkdir(parents=True, exist_ok=True)
    known = {}
    for name, experiment in experiments(make).items():
        table, known[name] = recorded(make, experiment, zlib.crc32(name.encode()) + seed,
                                      in_motion_s(make) if name == "fast" else 0.0)
        np.savetxt(folder / f"{name}.csv", table, ("%.9g", "%.7g", "%.7f"), ",",
                   header="time_s,voltage_v,displacement_um", comments="")
    (folder / KNOWN).write_text(json.dumps({
        "make": make.name, "seed": seed, "noise_um": make.noise_um, "true": make.true,
        "recordings": {name: asdict(each) for name, each in known.items()}}, indent=1),
        encoding="utf-8")


def recorded(make: Make, experiment: Experiment, seed: int,
             approach_s: float) -> tuple[FloatArray, Known]:
    """Play an experiment on a make from rest and back; return the table and what is known of it.

    The table, (N, 3), has times (s), voltages (V) and measured displacements (um). The first
    `approach_s` of the waveform are excluded from the error.
    """
    rest_v = make.limits.rest_voltage_v
    ramp_v_per_s = make.limits.span_v / RAMP_S

    def played(each: Experiment) -> HeldVoltage:
        return HeldVoltage(with_ramps(each, rest_v, ramp_v_per_s), each.sample_period_s)

    past = [played(sweep(make.limits, CREEP_ROW_S)),
            HeldVoltage(np.full(round(REST_S / CREEP_ROW_S), rest_v), CREEP_ROW_S)]
    voltage = played(experiment)
    displacement_um = make.stage.displacement_um(past, voltage)
    random = np.random.default_rng(seed)
    time_s = voltage.period_s * np.arange(displacement_um.size, dtype=float)
    disturbance_um = make.noise_um * random.normal(size=time_s.size) + drift_um(
        make, time_s, random)
    measured_um = displacement_um + disturbance_um
    ramp_rows = with_ramps(experiment, rest_v, ramp_v_per_s).size - (
        experiment.voltage_v.size * experiment.repeats)
    # The duration of the ramp to the waveform is in proportion to its distance from rest.
    there_s = abs(experiment.voltage_v[0] - rest_v) / ramp_v_per_s
    back_s = ramp_rows * voltage.period_s - there_s
    counted_s = (there_s + approach_s, float(time_s[-1] - max(back_s, 0.0)))
    counts = (time_s >= counted_s[0]) & (time_s <= counted_s[1])
    return np.column_stack([time_s, voltage.voltage_v, measured_um]), Known(
        e_y_percent(measured_um[counts], displacement_um[counts]), counted_s)


def drift_um(make: Make, time_s: FloatArray, random: np.random.Generator) -> FloatArray:
    """Return a drift of the sensor, shape (N,): slow waves with random phases."""
    periods_s = make.drift_s * np.geomspace(0.5, 8.0, 9)
    waves = np.sin(2.0 * np.pi * time_s[:, None] / periods_s
                   + random.uniform(0.0, 2.0 * np.pi, periods_s.size))
    return make.drift_um * np.sqrt(2.0 / periods_s.size) * waves.sum(axis=1)


def experiments(make: Make) -> dict[str, Experiment]:
    """Return the experiments of the recordings by name."""
    limits = make.limits
    square_s = PERIODS_OF_MODE / make.first_mode_hz
    turns = [0.0, *VALIDATION_TURNS[1:-1], 0.04, 0.97, 0.31, 0.5]
    row_s = SLOW_ROW_S
    triangles = np.interp(np.arange(0.0, len(turns) - 1.0, row_s / TRIANGLE_S),
                          np.arange(len(turns)), turns)
    time_s = row_s * np.arange(round(SLOW_SINES_S / row_s))
    sines = 0.5 + sum(
        amplitude * (np.sin(2.0 * np.pi * frequency_hz * time_s + phase) - np.sin(phase))
        for frequency_hz, amplitude, phase in SLOW_SINES)
    slow_v = limits.voltage_min_v + limits.span_v * np.clip(np.append(triangles, sines), 0.0, 1.0)
    second_s = in_motion_s(make)
    return {
        "creep": creep(limits, sample_period_s=CREEP_ROW_S),
        "dynamics": chirp(make) if make.is_swept else dynamics(
            limits, square_s, max(SQUARE_WAVES * square_s, DYNAMICS_S)),
        "hysteresis": hysteresis(limits, LEVELS, sample_period_s=SLOW_ROW_S),
        "slow": Experiment("slow", slow_v, row_s, 1, "nested triangles, then slow sines"),
        "fast": multisine(limits, second_s, second_s, tones(make, TONE_SWING)),
        "mixed": validation(limits, 0.3 * second_s, second_s, tones(make, MIXED_SWING)),
    }


def in_motion_s(make: Make) -> float:
    """Return the duration of the unseen tones: many periods of the first mode."""
    return float(np.clip(1000.0 / make.first_mode_hz, 0.1, 10.0))


def tones(make: Make, swing: float) -> list[tuple[float, float]]:
    """Return frequencies and amplitudes of tones up to the first mode, equal in displacement."""
    frequencies_hz = make.first_mode_hz * np.array(TONES)
    gains = np.abs(make.stage.behind.at((2j * np.pi * frequencies_hz).astype(complex)))
    return [(float(frequency_hz), swing / max(1.0, float(gain)))
            for frequency_hz, gain in zip(frequencies_hz, gains, strict=True)]


def chirp(make: Make) -> Experiment:
    """Return a chirp about the middle of the range over all modes."""
    row_s = 1.0 / make.limits.sample_rate_hz
    time_s = row_s * np.arange(round(CHIRP_S / row_s))
    low_hz, high_hz = CHIRP_HZ
    periods = low_hz * time_s + 0.5 * (high_hz - low_hz) / CHIRP_S * time_s**2
    voltage_v = make.limits.middle_v + CHIRP_SWING * make.limits.span_v * np.sin(
        2.0 * np.pi * periods)
    return Experiment("dynamics", voltage_v, row_s, 1,
                      f"chirp from {low_hz:g} to {high_hz:g} Hz")
