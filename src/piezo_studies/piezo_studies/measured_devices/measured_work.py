# SPDX-License-Identifier: BSD-3-Clause
"""The work of `measured`: fit, compare with the published figures, draw."""

import json
from dataclasses import asdict

import numpy as np

from piezo_models.axes_model_file import save_axes_model
from piezo_studies.measured_devices import (
    further_sets,
    measured,
    measured_pictures,
    measured_sets,
    mirror,
    oscillators,
)
from piezo_studies.measured_devices.measured_diagnosis import FINDINGS


def measure_devices(options):
    """Fit the measured sets, and print and write the errors with the published ones."""
    data, output = options.data, options.output
    lines = {each.name: each.missing(data) for each in measured_sets.SETS}
    present = {name for name, line in lines.items() if line is None}
    for line in filter(None, lines.values()):
        print(line)
    if not present:
        raise ValueError(f"{data} holds none of the measured sets that are named above")
    output.mkdir(parents=True, exist_ok=True)
    figures = []
    for name in (each for each in SETS if each in present):
        print(f"fitting {name}", flush=True)
        figures += SETS[name](data, output)
    found = []
    for name in (each for each in OSCILLATORS if each in present):
        print(f"fitting and diagnosing {name}", flush=True)
        benchmark = OSCILLATORS[name](data)
        figures += benchmark.figures
        found.append(benchmark.finding)
    print("diagnosing poor models", flush=True)
    for name in (each for each in FINDINGS if each in present):
        found += FINDINGS[name](data)
    rows = [asdict(figure) | {"reached": figure.is_reached} for figure in figures]
    (output / "table.json").write_text(json.dumps(
        {"rows": rows, "findings": [asdict(finding) for finding in found]}, indent=1) + "\n")
    print()
    print(table(figures))
    print()
    for finding in found:
        print(finding.text())
    print(f"\ntable and pictures in {output}")


def _scanner(data, output):
    figures, predictions = measured.scanner(data)
    for figure, (title, prediction) in zip(figures, predictions.items(), strict=True):
        name = f"scanner_{figure.tested_on.replace(' ', '_')}.png"
        measured_pictures.draw_loops_and_difference(
            output / name, f"{title}: {figure.ours:.2f} %", prediction
        )
    return figures


def _cantilever(data, output):
    figures, prediction, ringing = measured.cantilever(data)
    cycles = figures[0]
    measured_pictures.draw_loops_and_difference(
        output / "cantilever_cycles.png",
        f"cantilever, fitted on {cycles.fitted_on}, tested on {cycles.tested_on}: "
        f"{cycles.ours:.3f} %", prediction,
    )
    measured_pictures.draw_ringing(
        output / "cantilever_ringing.png", "cantilever, ringing after the jump", ringing,
        measured.RINGING_FITTED_S,
    )
    return figures


def _nanopositioner(data, output):
    figures, response, modelled, predicted = measured.nanopositioner(data)
    measured_pictures.draw_frequency_response(
        output / "nanopositioner.png",
        f"nanopositioner, frequencies predicted by fits without them: {figures[0].ours:.2g} %",
        response.frequency_hz, response.gain, modelled, predicted,
    )
    return figures


def _mirror(data, output):
    figures, identified = mirror.mirror(data)
    save_axes_model(output / "steering_mirror.json", identified)
    print(identified.summary())
    return figures


SETS = {"scanner": _scanner, "cantilever": _cantilever, "nanopositioner": _nanopositioner,
        "steering mirror": _mirror,
        "cascaded tanks": lambda data, output: further_sets.tanks(data),
        "robot arm": lambda data, output: further_sets.robot_arm(data),
        "CD player's arm": lambda data, output: further_sets.player_arm(data)}

OSCILLATORS = {"the circuit": oscillators.circuit, "Bouc-Wen": oscillators.bouc_wen}


def table(figures):
    """Return a text table with a row for each figure.

    Parameters
    ----------
    figures : list of Figure
    """
    head = ("set", "fitted on", "tested on", "error", "in the note", "ours", "at most", "")
    rows = [head] + [
        (figure.data, figure.fitted_on, figure.tested_on, figure.quantity,
         "none" if np.isnan(figure.note) else f"{figure.note:.3g} {figure.unit}",
         f"{figure.ours:.3g} {figure.unit}",
         f"{figure.bound:.3g} {figure.unit}", _verdict(figure))
        for figure in figures
    ]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    )


def _verdict(figure):
    if figure.is_reached:
        return figure.remark
    missed = f"missed by {figure.ours - figure.bound:.3g} {figure.unit}"
    return f"{missed}; {figure.remark}" if figure.remark else missed
