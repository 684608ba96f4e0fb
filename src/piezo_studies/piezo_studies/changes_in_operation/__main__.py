# SPDX-License-Identifier: BSD-3-Clause
"""Watch a stage of another form than its model, then change it; write docs/monitor.md."""

import argparse
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

from piezo_identification.experiments.catalogue import named_experiment
from piezo_identification.identification.identify import identify
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import load_model, save_model
from piezo_recorder.reading.recording import Recording
from piezo_sim.plant.plant_file import read_plant
from piezo_studies.changes_in_operation.doubled import CHANGES, table, watch_doubling
from piezo_studies.changes_in_operation.reference_kinds import KINDS
from piezo_studies.changes_in_operation.watched import WatchedStage, watch_unchanged
from piezo_studies.marked_sections import write_sections
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


SECTION = "changes in operation"
"""Mark of the table in the page."""


def main(arguments: list[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="changes_in_operation", description=__doc__)
    parser.add_argument("--page", type=Path, default=Path("docs/monitor.md"),
                        help="page whose table is written again; its text stays")
    parser.add_argument("--output", type=Path, default=Path("runs/changes-in-operation"),
                        help="folder of the model; one that it has is taken as it is")
    parser.add_argument("--hours", type=float, default=10.0,
                        help="time of the stage in which nothing changes")
    options = parser.parse_args(arguments)
    watched = WatchedStage(read_plant(PLANT), identified_beam(options.output))
    at_first = watched.copy()
    reports = watch_unchanged(watched, options.hours)
    for report in reports:
        print(f"{report.kind}: {report.suspicion.sentence()}")
    rows = []
    for change in CHANGES:
        later, first = ([watch_doubling(stage, kind, change) for kind in KINDS]
                        for stage in (watched, at_first))
        rows.append((change, later, first))
    lines = (f"Suspicions in {options.hours:g} h in which nothing changed: {len(reports)}.\n\n"
             + table(rows))
    write_sections(options.page, {SECTION: lines})
    print(lines)


if __name__ == "__main__":
    main()
