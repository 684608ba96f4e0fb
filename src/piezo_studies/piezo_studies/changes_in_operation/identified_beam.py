# SPDX-License-Identifier: BSD-3-Clause
"""Record and identify the simulated stage `beam`, whose form differs from that of the models."""

from dataclasses import replace
from hashlib import sha256
from pathlib import Path

from piezo_identification.experiments.catalogue import named_experiment
from piezo_identification.identification.identify import identify
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import load_model, save_model
from piezo_recorder.reading.recording import Recording
from piezo_studies.thesis.laboratory import record_experiment

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
    made = record_experiment(named_experiment(name), seed=seed, plant=PLANT)
    return replace(made, sha256=sha256(made.displacement_um.tobytes()).hexdigest())
