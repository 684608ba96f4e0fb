# SPDX-License-Identifier: BSD-3-Clause
"""Identify from every kind of recording with the command, and predict unseen data."""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_studies.other_makes.hystereses import Duhem, Plays
from piezo_studies.other_makes.linear_system import HeldVoltage, Stage, lag, logarithmic_creep, mode
from piezo_studies.recording_kinds.laboratory_voltages import KINDS, Played, validation

REST_S = 20.0
"""Duration (s) of the rise from 0 V to the first voltage of a recording, and of the rest there."""

RISE_ROWS = 400
"""Number of rows of that rise, and of that rest."""


def play_stage() -> Stage:
    """Return a stage with plays between two curves, for 100 V and about 13 um."""
    widths_v = np.linspace(0.0, 25.0, 12)
    weights = 0.12 * np.append(0.8, 0.04 * np.exp(-widths_v[1:] / 15.0))
    modes = mode(620.0, 0.02, 0.92).parallel_to(mode(1450.0, 0.015, 0.08))
    return Stage(Plays(widths_v, weights, (1.0, 1.5e-3), (1.002, 1.0e-3)),
                 logarithmic_creep(0.012, 1e-3, 1e4).then(modes).then(lag(4e-4)))


def duhem_stage() -> Stage:
    """Return a stage with the Duhem equation and slower modes, for 100 V and about 30 um."""
    modes = mode(210.0, 0.03, 0.9).parallel_to(mode(760.0, 0.02, 0.1))
    return Stage(Duhem(0.2, 0.2, 0.4, 0.03, 0.5),
                 logarithmic_creep(0.008, 1e-3, 1e4).then(modes).then(lag(8e-4)))


def displacement_um(stage: Stage, voltage_v: FloatArray, period_s: float) -> FloatArray:
    """Return the displacement, (N,), of a rested stage while a voltage is played."""
    past_v = np.append(np.linspace(0.0, voltage_v[0], RISE_ROWS),
                       np.full(RISE_ROWS, voltage_v[0]))
    return stage.displacement_um([HeldVoltage(past_v, REST_S / RISE_ROWS)],
                                 HeldVoltage(voltage_v, period_s))


COMMAND = ("piezo_offline.piezo_command", "identify")
STAGES: dict[str, Callable[[], Stage]] = {"plays": play_stage, "Duhem": duhem_stage}
NOISE = 2e-4
"""Standard deviation of the sensor's noise, as a fraction of the range of its recording."""

DRIFT_OF_MINUTE, DRIFT_TIME_S = 0.02, 400.0
"""Drift of a warming stage per minute at first, as a fraction of the range, and its time
constant (s)."""

GAP = (0.55, 0.62)
"""Beginning and end of a gap, as fractions of the recording."""

VARIANTS = ("plain", "drift", "gap", "two recordings")
REFUSED = 2
"""Exit status of a command that cannot use its input."""


@dataclass(frozen=True)
class Trial:
    """The input of an identification."""

    stage: str
    """Key of `STAGES`."""
    kinds: dict[str, str]
    """Kind of the recordings by experiment."""
    varied: str = ""
    """Experiment whose recordings are a variant; empty if there is none."""
    variant: str = VARIANTS[0]
    """One of `VARIANTS`."""

    def __str__(self) -> str:
        given = ", ".join(f"{name}: {kind}" for name, kind in self.kinds.items())
        return f"{self.stage}; {given}" + (f"; {self.varied} with {self.variant}" if self.varied
                                           else "")


@dataclass(frozen=True)
class Outcome:
    """The result of an identification."""

    error_percent: float
    """Relative error (4.20) on the validation; nan without a model."""
    verdict: str
    """``adequate``, ``inadequate`` with the components, ``refused`` with the reason, or ``failed``
    with the last line of a traceback."""
    cpu_s: float
    """Processor time, including start and reading."""


def trials(stages: tuple[str, ...] = tuple(STAGES)) -> Iterator[Trial]:
    """Yield trials that vary the kind of one recording, its variant, or the omitted experiment."""
    usual = {name: next(iter(kinds)) for name, kinds in KINDS.items()}
    for stage in stages:
        yield Trial(stage, usual)
        for experiment, kinds in KINDS.items():
            for kind in kinds:
                given = usual | {experiment: kind}
                if given != usual:
                    yield Trial(stage, given)
                for variant in VARIANTS[1:]:
                    yield Trial(stage, given, experiment, variant)
                for left_out in KINDS:
                    if left_out != experiment:
                        yield Trial(stage, {name: given[name] for name in given
                                            if name != left_out})


def run(trial: Trial, folder: Path) -> Outcome:
    """Record the stage of a trial unless the folder has it, identify it, and read the result."""
    model = folder / "model.json"
    model.unlink(missing_ok=True)
    arguments = ["--output", str(model), "--no-report"]
    for name, kind in trial.kinds.items():
        variant = trial.variant if name == trial.varied else VARIANTS[0]
        files = recordings(trial.stage, name, kind, variant, folder)
        arguments += [f"--{name}", *map(str, files)]
    unseen = recorded(trial.stage, "validation", validation(), VARIANTS[0], folder)
    process = subprocess.Popen(
        [sys.executable, "-m", *COMMAND, *arguments, "--validation", str(unseen)],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    printed = process.stdout.read() if process.stdout else ""
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    (folder / "printed.txt").write_text(printed, encoding="utf-8")
    cpu_s = usage.ru_utime + usage.ru_stime
    last = printed.strip().splitlines()[-1] if printed.strip() else ""
    if process.returncode:
        is_refused = process.returncode == REFUSED and "Traceback" not in printed
        return Outcome(np.nan, f"{'refused' if is_refused else 'failed'}: {last}", cpu_s)
    document = json.loads(model.read_text(encoding="utf-8"))
    return Outcome(document["errors"]["e_y_percent"], _verdict(document["adequacy"]), cpu_s)


def _verdict(adequacy: dict[str, dict[str, object]]) -> str:
    poor = [name for name, each in adequacy.items() if each["verdict"] != "adequate"]
    return f"inadequate: {', '.join(poor)}" if poor else "adequate"


def recordings(stage: str, experiment: str, kind: str, variant: str, folder: Path) -> list[Path]:
    """Return the files of one experiment, two for the last variant; see `recorded`."""
    played = KINDS[experiment][kind]()
    name = f"{experiment} {kind}"
    if variant != VARIANTS[-1]:
        return [recorded(stage, name, played, variant, folder)]
    mirrored = Played(played.period_s, 100.0 - played.voltage_v, played.lead_rows, played.finer)
    return [recorded(stage, name, played, VARIANTS[0], folder),
            recorded(stage, f"{name} mirrored", mirrored, VARIANTS[0], folder)]


def recorded(stage: str, name: str, played: Played, variant: str, folder: Path) -> Path:
    """Record a stage for a voltage in a table, unless the folder already has it.

    The variant is one of `VARIANTS` except the last.
    """
    path = folder / f"{stage} {name} {variant}.csv".replace(" ", "_")
    if path.exists():
        return path
    table = _table(STAGES[stage](), played, seed=sum(map(ord, name)))
    if variant == "drift":
        scale_um = DRIFT_OF_MINUTE * np.ptp(table[:, 2]) * DRIFT_TIME_S / 60.0
        table[:, 2] += scale_um * -np.expm1(-table[:, 0] / DRIFT_TIME_S)
    if variant == "gap":
        first, last = (round(part * len(table)) for part in GAP)
        table = np.delete(table, slice(first, last), axis=0)
    np.savetxt(path, table, "%.8g", ",", header="time [s],voltage [V],displacement [um]",
               comments="")
    return path


def _table(stage: Stage, played: Played, seed: int) -> FloatArray:
    """Return times, voltages and displacements of the rows of a logger."""
    moved_um = displacement_um(stage, played.voltage_v, played.period_s / played.finer)
    rows = slice(played.lead_rows * played.finer, None, played.finer)
    voltage_v, moved_um = played.voltage_v[rows], moved_um[rows]
    noise = np.random.default_rng(seed).normal(size=voltage_v.size)
    return np.column_stack([
        played.period_s * np.arange(voltage_v.size), voltage_v,
        moved_um + NOISE * np.ptp(moved_um) * noise])
