# SPDX-License-Identifier: BSD-3-Clause
"""Record and identify the simulated stage `beam`, whose form differs from that of the models."""

from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np

from piezo_identification.experiments.catalogue import Experiment, named_experiment
from piezo_identification.identification.identify import identify
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import load_model, save_model
from piezo_recorder.reading.recording import Recording
from piezo_sim.simulated_stage import SimulatedStage
from piezo_studies.thesis.laboratory import CLOCK_HZ, SAMPLES_AT_ONCE, recording

PLANT = "beam"
RECORDED = "creep", "dynamics", "hysteresis", "validation"


def identified_beam(folder: Path) -> IdentifiedModel:
    """Identify the beam, or return its model if the folder contains one."""
    path = folder / "model.json"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        creep, dynamics, hysteresis, validation = (
            _record(name, seed) for seed, name in enumerate(RECORDED, start=1))
        save_model(path, identify(creep, dynamics, hysteresis, validation))
    return load_model(path)


def _record(name: str, seed: int) -> Recording:
    experiment = named_experiment(name)
    assert isinstance(experiment, Experiment)
    held = round(experiment.sample_period_s * CLOCK_HZ)
    ramp_v = np.linspace(0.0, experiment.voltage_v[0], max(1, round(0.1 * CLOCK_HZ / held)))
    voltage_v = np.append(ramp_v, np.tile(experiment.voltage_v, experiment.repeats))
    stage = SimulatedStage(PLANT, seed, CLOCK_HZ)
    stage.open()
    displacement_um, rows = np.empty(voltage_v.size), max(1, SAMPLES_AT_ONCE // held)
    for begin in range(0, voltage_v.size, rows):
        part = slice(begin, begin + rows)
        played_um = stage.exchange(np.repeat(voltage_v[part], held))
        displacement_um[part] = played_um.reshape(-1, held).mean(axis=1)
    made = recording(name, voltage_v, displacement_um, CLOCK_HZ, held, ramp_v.size)
    return replace(made, sha256=sha256(displacement_um.tobytes()).hexdigest())
