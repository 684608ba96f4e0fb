# SPDX-License-Identifier: BSD-3-Clause
"""The work of `measured`: fit public sets, compare with the published figures, draw."""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from piezo_models.axes_model_file import save_axes_model
from piezo_studies.measured_devices import (
    further_sets,
    measured,
    measured_pictures,
    mirror,
    oscillators,
)
from piezo_studies.measured_devices.measured import Figure
from piezo_studies.measured_devices.measured_diagnosis import (
    Finding,
    cantilever_without_vibration,
    nanopositioner_without_creep,
    scanner_without_asymmetry,
)
from piezo_studies.tables import text_table

NO_LICENCE = "none known that lets others redistribute it"
DAISY = "https://homes.esat.kuleuven.be/~smc/daisy"
COLUMNS = "columns time_s, voltage_v, displacement_um"
OWNERS = NO_LICENCE, "ask the owners"


Measured = tuple[list[Figure], list[Finding]]
"""Errors, and the results of diagnoses."""


@dataclass(frozen=True)
class MeasuredSet:
    """Files of one device below the directory of the measured sets."""

    name: str

    files: tuple[str, ...]
    """Required files, relative to the directory of the measured sets."""
    source: str
    licence: str
    fetch: str
    """Source, licence, and how to obtain the files, for messages."""
    measure: Callable[[Path, Path], Measured]
    """Fits the set in a directory, and writes pictures and models into another."""

    def missing(self, directory: Path) -> str | None:
        """Return a message about the first missing file; None if all are present."""
        absent = next((name for name in self.files if not (directory / name).is_file()), None)
        if absent is None:
            return None
        return (f"skipped {self.name}: {directory / absent} is not there. Source: {self.source}; "
                f"licence: {self.licence}; to fetch: {self.fetch}")


def measure_devices(options):
    """Fit the measured sets, and print and write the errors with the published ones."""
    data, output = options.data, options.output
    lines = {each.name: each.missing(data) for each in SETS}
    present = [each for each in SETS if lines[each.name] is None]
    for line in filter(None, lines.values()):
        print(line)
    if not present:
        raise ValueError(f"{data} holds none of the measured sets that are named above")
    output.mkdir(parents=True, exist_ok=True)
    figures, found = [], []
    for each in present:
        print(f"fitting and diagnosing {each.name}", flush=True)
        of_set, findings = each.measure(data, output)
        figures += of_set
        found += findings
        _write_table(output / "table.json", figures, found)
    print()
    print(text_table([HEAD, *map(_cells, figures)]))
    print()
    for finding in found:
        print(finding.text())
    print(f"\ntable and pictures in {output}")


def _write_table(path, figures, found):
    """Write the errors and findings so far: later sets take minutes, and may fail."""
    rows = [asdict(figure) | {"reached": figure.is_reached} for figure in figures]
    path.write_text(json.dumps(
        {"rows": rows, "findings": [asdict(finding) for finding in found]}, indent=1) + "\n")


def _scanner(data, output):
    figures, predictions = measured.scanner(data)
    for figure, (title, prediction) in zip(figures, predictions.items(), strict=True):
        name = f"scanner_{figure.tested_on.replace(' ', '_')}.png"
        measured_pictures.draw_loops_and_difference(
            output / name, f"{title}: {figure.ours:.2f} %", prediction)
    return figures, [*scanner_without_asymmetry(data)]


def _cantilever(data, output):
    (cycles,), prediction = measured.cantilever(data)
    measured_pictures.draw_loops_and_difference(
        output / "cantilever_cycles.png",
        f"cantilever, fitted on {cycles.fitted_on}, tested on {cycles.tested_on}: "
        f"{cycles.ours:.3f} %", prediction)
    return [cycles], [cantilever_without_vibration(data)]


def _nanopositioner(data, output):
    figures, response, modelled, predicted = measured.nanopositioner(data)
    measured_pictures.draw_frequency_response(
        output / "nanopositioner.png",
        f"nanopositioner, frequencies predicted by fits without them: {figures[0].ours:.2g} %",
        response.frequency_hz, response.gain, modelled, predicted)
    return figures, [nanopositioner_without_creep(data)]


def _mirror(data, output):
    figures, identified = mirror.mirror(data)
    save_axes_model(output / "steering_mirror.json", identified)
    print(identified.summary())
    return figures, []


SETS = (
    MeasuredSet(
        "scanner", (measured.NESTED_LOOPS, measured.MAJOR_LOOPS),
        "x axis of a piezo scanner of an AFM, by its owners", *OWNERS, _scanner),
    MeasuredSet(
        "cantilever", (measured.CANTILEVER,), "a piezo cantilever, by its owners", *OWNERS,
        _cantilever),
    MeasuredSet(
        "nanopositioner", (measured.NANOPOSITIONER,), "a flexure nanopositioner, by its owners",
        *OWNERS, _nanopositioner),
    MeasuredSet(
        "the circuit", oscillators.CIRCUIT_FILES,
        "https://www.nonlinearbenchmark.org/benchmarks/silverbox", NO_LICENCE,
        f"{COLUMNS}, from the Python package nonlinear-benchmarks",
        lambda data, output: oscillators.circuit(data)),
    MeasuredSet(
        "Bouc-Wen", oscillators.BOUC_WEN_FILES,
        "https://www.nonlinearbenchmark.org/benchmarks/bouc-wen", NO_LICENCE,
        f"{COLUMNS}, from that page", lambda data, output: oscillators.bouc_wen(data)),
    MeasuredSet(
        "steering mirror", mirror.FILES,
        "https://github.com/merijnfloren/fsm-benchmark-data", "CC BY 4.0",
        "the folder data of that repository, as fine_steering_mirror", _mirror),
    MeasuredSet(
        "cascaded tanks", (further_sets.TANKS,),
        "https://www.nonlinearbenchmark.org/benchmarks/cascaded-tanks", NO_LICENCE,
        "dataBenchmark.csv of that page, in cascaded_tanks",
        lambda data, output: (further_sets.tanks(data), [])),
    MeasuredSet(
        "robot arm", (further_sets.ROBOT_ARM,), f"{DAISY}, set 96-009", NO_LICENCE,
        "robot_arm.dat of that page, in robot_arm",
        lambda data, output: (further_sets.robot_arm(data), [])),
    MeasuredSet(
        "CD player's arm", (further_sets.PLAYER_ARM,), f"{DAISY}, set 96-007", NO_LICENCE,
        "CD_player_arm.dat of that page, in cd_player_arm",
        lambda data, output: (further_sets.player_arm(data), [])),
)

HEAD = ("set", "fitted on", "tested on", "error", "in the note", "ours", "at most", "")


def _cells(figure):
    """Return the cells of a figure below `HEAD`."""
    missed = ([] if figure.is_reached
              else [f"missed by {figure.ours - figure.bound:.3g} {figure.unit}"])
    return (figure.data, figure.fitted_on, figure.tested_on, figure.quantity,
            "none" if np.isnan(figure.note) else f"{figure.note:.3g} {figure.unit}",
            f"{figure.ours:.3g} {figure.unit}", f"{figure.bound:.3g} {figure.unit}",
            "; ".join([*missed, *filter(None, [figure.remark])]))
