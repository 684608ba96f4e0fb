# SPDX-License-Identifier: BSD-3-Clause
"""Time the diagnosis beside one simulation of the same samples, for every kind of verdict.

`python diagnosis_speed.py [CASE...]` prints both, and the time of a processor, which counts the
cores together and depends little on what else they do.
"""

import sys
import time
from dataclasses import dataclass, replace

import numpy as np
from stage_model import SAMPLE_RATE_HZ, stage_model

from piezo_identification.diagnosis.diagnose import diagnose
from piezo_identification.diagnosis.joint.identification_recordings import IdentificationRecordings
from piezo_models.effects import Effect
from piezo_models.effects.rate_dependent_hysteresis import RateDependentHysteresis
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.effects.voltage_clipping import VoltageClipping
from piezo_studies.thesis.laboratory import recording

SAMPLES, MANY_SAMPLES, RECORDINGS = 400_000, 1_000_000, 2
IDENTIFIED_FROM_SAMPLES = 50_000
LEVEL_S, LEVELS_V = 0.02, (5.0, 95.0)
NOISE_UM = 0.009
HEATING_S, HEATING_PER_V = 0.2, 2e-4
"""Of a gain that follows the mean change of the voltage: no effect on the list does that."""


@dataclass(frozen=True)
class Case:
    """What a stage has and its model lacks, and the verdict it must come to."""

    effects: tuple[Effect, ...]
    verdict: str
    named: str | None = None
    """Effect that must be named first."""
    is_heated: bool = False
    """Whether the gain follows the mean change of the voltage."""


CASES = {
    "none": Case((), "none"),
    "explained": Case((VibrationMode(8800.0, 0.02, 0.02),), "explained", VibrationMode.name),
    "unexplained": Case((), "unexplained", is_heated=True),
    "rate dependence": Case((RateDependentHysteresis(0.5, 100.0, 0.02, 1e-3),), "explained",
                            RateDependentHysteresis.name),
    "clipped": Case((VoltageClipping(8.0, 80.0),), "explained", VoltageClipping.name),
}


def recorded(model, samples, seed, is_heated=False):
    """Random levels on a stage with noise."""
    generator = np.random.default_rng(seed)
    held = round(LEVEL_S * SAMPLE_RATE_HZ)
    voltage_v = np.repeat(generator.uniform(*LEVELS_V, -(-samples // held)), held)[:samples]
    displacement_um = model.simulate(voltage_v, 1.0 / SAMPLE_RATE_HZ)
    if is_heated:
        changes_v = np.abs(np.diff(voltage_v[::held], prepend=voltage_v[0]))
        decay = np.exp(-LEVEL_S / HEATING_S)
        heat_v = np.zeros(changes_v.size)
        for n in range(1, changes_v.size):
            heat_v[n] = decay * heat_v[n - 1] + (1.0 - decay) * changes_v[n]
        displacement_um *= 1.0 + HEATING_PER_V * np.repeat(heat_v, held)[:samples]
    noise_um = generator.normal(scale=NOISE_UM, size=samples)
    return recording(
        f"random levels {seed}", voltage_v, displacement_um + noise_um, SAMPLE_RATE_HZ)


def diagnosis_times_s(name, samples=SAMPLES, recordings=RECORDINGS):
    """Return the times (s) of a simulation, and of the diagnosis of the same samples.

    The name is one of `CASES`. RuntimeError is raised if the diagnosis comes to another verdict.
    """
    case, model = CASES[name], stage_model()
    stage = replace(model, effects=case.effects)
    given = [recorded(stage, samples // recordings, number, case.is_heated)
             for number in range(recordings)]
    # The effect came after the identification.
    known = IdentificationRecordings((recorded(model, IDENTIFIED_FROM_SAMPLES, recordings),), ())
    times_s = [time.perf_counter()]
    for each in given:
        model.simulate(each.voltage_v, 1.0 / SAMPLE_RATE_HZ)
    times_s.append(time.perf_counter())
    found = diagnose(model, given, identified_from=known)
    times_s.append(time.perf_counter())
    first = found.effects[0]["name"] if found.effects else None
    if (found.verdict, first) != (case.verdict, case.named):
        raise RuntimeError(
            f"{name}: {found.verdict} by {first}, not {case.verdict} by {case.named}")
    return tuple(np.diff(times_s))


if __name__ == "__main__":
    for asked in sys.argv[1:] or CASES:
        begun_s = time.process_time()
        times_s = diagnosis_times_s(asked)
        print(asked, *(f"{time_s:.3f} s" for time_s in times_s),
              f"{time.process_time() - begun_s:.1f} s of a processor", flush=True)
