# SPDX-License-Identifier: BSD-3-Clause
"""Time check, identify and diagnose over the number of rows, from 1e5 to 1e7.

`python rows_speed.py [ROWS...]` prints time and processor time of each. The work of the commands is
timed, without the reading of files.
"""

import argparse
import time
from dataclasses import replace

import numpy as np
from stage_model import SAMPLE_RATE_HZ, VOLTAGE_RANGE_V, stage_model
from table import Measurements, show

from piezo_identification.diagnosis.diagnose import diagnose
from piezo_identification.diagnosis.joint.identification_recordings import IdentificationRecordings
from piezo_identification.experiments import catalogue
from piezo_identification.experiments.stage_limits import StageLimits
from piezo_identification.identification.identify import identify
from piezo_identification.recording_check.check import check_recording
from piezo_identification.recording_check.suitability import suitability
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_studies.thesis.laboratory import recording

ROWS = (100_000, 1_000_000, 10_000_000)
NOISE_UM = 0.009
LIMITS = StageLimits(*VOLTAGE_RANGE_V, 2.0e6, SAMPLE_RATE_HZ, 0.0, 40)
CREEP_S, HARMONICS, HARMONIC_S = 400.0, 20, 2.0
"""Slow recordings last as long whatever their rows, which come faster; fast ones last longer."""

ARC_PART = 0.5
"""Part of the validation that is slow arcs."""

LACKING = VibrationMode(8800.0, 0.02, 0.02)
"""What the stage has when it is diagnosed, and did not have when it was identified."""

LIMITS_S = {"check": 3.0, "identify": 60.0, "diagnose": 60.0}
"""For `LIMITED_ROWS` rows on two idle cores."""

LIMITED_ROWS = 1_000_000


def recorded(experiment, stage, seed):
    """Return what a sensor with noise records of an experiment, an array row each."""
    voltage_v = np.tile(experiment.voltage_v, experiment.repeats)
    period_s = experiment.sample_period_s
    displacement_um = stage.simulate(voltage_v, period_s)
    displacement_um += NOISE_UM * np.random.default_rng(seed).normal(size=voltage_v.size)
    return replace(recording(f"{experiment.name} {seed}", voltage_v, displacement_um,
                             1.0 / period_s), sha256=f"{seed:064x}")


def experiments(rows):
    """Return the four experiments of an identification, of so many rows together."""
    each = rows // 4
    duration_s = each / SAMPLE_RATE_HZ
    arcs = len(catalogue.VALIDATION_TURNS) - 1
    return {
        "creep": catalogue.creep(replace(
            LIMITS, sample_rate_hz=each / CREEP_S), CREEP_S, CREEP_S / each),
        "dynamics": catalogue.dynamics(LIMITS, duration_s=duration_s),
        "hysteresis": catalogue.hysteresis(replace(
            LIMITS, sample_rate_hz=each / HARMONICS / HARMONIC_S), HARMONICS, HARMONIC_S,
            HARMONICS * HARMONIC_S / each),
        "validation": catalogue.validation(
            LIMITS, ARC_PART * duration_s / arcs, (1.0 - ARC_PART) * duration_s),
    }


def explained(diagnosis):
    """Raise RuntimeError if a diagnosis does not name what the stage has."""
    named = [effect["name"] for effect in diagnosis.effects]
    if (diagnosis.verdict, named) != ("explained", [LACKING.name]):
        raise RuntimeError(f"{diagnosis.verdict} by {named}, not explained by {LACKING.name}")


def times_s(rows):
    """Return the time of the clock and of the processor of each command, by its name."""
    stage, given = stage_model(), {}
    for seed, (name, experiment) in enumerate(experiments(rows).items()):
        given[name] = recorded(experiment, stage, seed)
    unseen = recorded(experiments(4 * rows)["validation"], replace(stage, effects=(LACKING,)), 4)
    known = IdentificationRecordings(tuple(
        given[name] for name in ("creep", "dynamics", "hysteresis")), ())
    works = {
        "check": lambda: suitability(check_recording(unseen)),
        "identify": lambda: identify(**given),
        "diagnose": lambda: explained(diagnose(stage, [unseen], identified_from=known)),
    }
    times = {}
    for name, work in works.items():
        begun_s = time.perf_counter(), time.process_time()
        work()
        times[name] = time.perf_counter() - begun_s[0], time.process_time() - begun_s[1]
    return times


def measure(measured, counts=ROWS):
    """Add the time of each command, and how much more a row of many costs than one of few."""
    times_s(counts[0])  # compiles
    before = {}
    for rows in counts:
        for name, (wall_s, processor_s) in times_s(rows).items():
            row = f"{name}, {rows:,} rows"
            measured[row, "s"].append(wall_s)
            measured[f"{row}, processor", "s"].append(processor_s)
            if name in before:
                few, few_s = before[name]
                measured[f"{row}: a row over one of {few:,}", "times"].append(
                    processor_s / rows / (few_s / few))
            before[name] = rows, processor_s


TARGETS = {f"{name}, {LIMITED_ROWS:,} rows": {"at_most": limit_s}
           for name, limit_s in LIMITS_S.items()} | {
    f"{name}, {many:,} rows: a row over one of {few:,}": {"at_most": 1.0}
    for few, many in zip(ROWS[:-1], ROWS[1:], strict=True) for name in LIMITS_S}
"""A row of many may cost no more than one of few: no worse than linear."""


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rows", type=int, nargs="*", default=ROWS)
    asked = parser.parse_args().rows
    table = Measurements()
    measure(table, tuple(asked))
    show(table.table(TARGETS))
