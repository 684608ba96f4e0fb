# SPDX-License-Identifier: BSD-3-Clause
"""Time the diagnosis of a stage that shares no form with the model.

`python stranger_diagnosis.py [CASE...]` takes the stage of generalised plays of
`piezo_studies.recording_kinds`. The model is identified once, and kept in the folder. The
recordings of its identification are fitted, too, with up to 50,000 rows each.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from piezo_identification.commands.identify_command import main as identify
from piezo_identification.diagnosis.diagnose import diagnose
from piezo_identification.diagnosis.joint.identification_recordings import (
    IdentificationRecordings,
)
from piezo_models.model_file import load_model
from piezo_studies.recording_kinds.laboratory_voltages import KINDS, Played, validation
from piezo_studies.recording_kinds.trials import NOISE, play_stage, recorded
from piezo_studies.recording_kinds.trials import displacement_um as displacement_of_stage
from piezo_studies.thesis.laboratory import recording

WAVEFORMS = {"creep": KINDS["creep"]["square wave"], "dynamics": KINDS["dynamics"]["steps"],
             "hysteresis": KINDS["hysteresis"]["nested triangles"], "validation": validation}
"""Of the identification."""

PERIOD_S, LEVEL_S, LEVELS_V = 5e-5, 0.02, (5.0, 95.0)
"""Period of the rows that are diagnosed, how long each level of the voltage lasts, and between
which the levels are drawn."""

REPEATS = {"creep": 10, "dynamics": 3, "hysteresis": 10, "validation": 4}
"""Rows of each of them that are asked, for one row from which the model is identified."""

GAP_UM = 0.12
"""Of the play."""
CLIPPED_V = 8.0, 74.0
"""Between which an amplifier clips the voltage."""
WALK_SAMPLES, WALK = 400, 1.4e-3
"""After how many samples the gain takes another step, and the standard deviation of the steps."""


def as_it_was(voltage_v, displacement_um):
    """Return the displacement of the stage as it was identified."""
    return displacement_um


def with_play(voltage_v, displacement_um):
    """Follow the displacement with a play."""
    behind_um, last = np.empty_like(displacement_um), displacement_um[0]
    for n, place in enumerate(displacement_um):
        behind_um[n] = last = min(max(last, place - 0.5 * GAP_UM), place + 0.5 * GAP_UM)
    return behind_um


def with_wandering_gain(voltage_v, displacement_um):
    """Multiply by a random walk: no effect on the list does that."""
    passed = np.arange(displacement_um.size) / WALK_SAMPLES
    steps = np.random.default_rng(5).normal(scale=WALK, size=int(passed[-1]) + 2)
    return displacement_um * (1.0 + np.interp(passed, np.arange(steps.size), np.cumsum(steps)))


CASES = {"none": as_it_was, "play": with_play, "wandering gain": with_wandering_gain,
         "clipped": as_it_was}


def recorded_motion(path, played, behind=as_it_was, seed=0):
    """Record the stage under a voltage, with noise, and with one of `CASES` behind it."""
    displacement_um = behind(played.voltage_v, displacement_of_stage(
        play_stage(), played.voltage_v, played.period_s))
    noise = np.random.default_rng(seed).normal(size=displacement_um.size)
    noise_um = NOISE * np.ptp(displacement_um) * noise
    return recording(path, played.voltage_v, displacement_um + noise_um, 1.0 / played.period_s)


def identified(folder):
    """Return the model of the stage, identified from short recordings unless the folder has it."""
    path = folder / "model.json"
    if not path.exists():
        given = [
            argument for name, waveform in WAVEFORMS.items()
            for argument in (
                f"--{name}", str(recorded("plays", name, waveform(), "plain", folder)))]
        identify([*given, "--output", str(path), "--no-report"])
    return load_model(path).model


def old_recordings():
    """Return longer recordings of what the model was identified from."""
    found = []
    for seed, (name, waveform) in enumerate(WAVEFORMS.items()):
        played, repeats = waveform(), REPEATS[name]
        longer = Played(played.period_s / repeats, np.repeat(played.voltage_v, repeats))
        found.append(recorded_motion(name, longer, seed=seed))
    return found


def main():
    """Diagnose the cases that are asked for, and print verdict, processor and wall time."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("case", nargs="*", help=f"of {', '.join(CASES)}; by default all")
    parser.add_argument("--samples", type=int, default=200_000)
    parser.add_argument("--folder", type=Path, default=Path("runs/stranger"))
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    model = identified(options.folder)
    known = IdentificationRecordings(tuple(old_recordings()), ())
    rows = round(LEVEL_S / PERIOD_S)
    for case in options.case or CASES:
        levels_v = np.random.default_rng(100).uniform(*LEVELS_V, -(-options.samples // rows))
        voltage_v = np.repeat(levels_v, rows)[: options.samples]
        reached_v = np.clip(voltage_v, *CLIPPED_V) if case == "clipped" else voltage_v
        new = recorded_motion(case, Played(PERIOD_S, reached_v), CASES[case], 50)
        new.voltage_v[:] = voltage_v
        begun_s, used_s = time.perf_counter(), time.process_time()
        found = diagnose(model, [new], identified_from=known)
        print(f"{case}, {options.samples:,} rows: {found.verdict} "
              f"{[effect['name'] for effect in found.effects]}, "
              f"{time.process_time() - used_s:.1f} s of a processor, "
              f"{time.perf_counter() - begun_s:.1f} s", flush=True)


if __name__ == "__main__":
    main()
