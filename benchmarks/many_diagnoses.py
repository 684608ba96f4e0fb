# SPDX-License-Identifier: BSD-3-Clause
"""Diagnose the recordings of a fleet on Dask workers of this machine, which one of them kills.

    python benchmarks/many_diagnoses.py [--recordings 200] [--workers 2] [--output runs/fleet]

The recordings are made by NumPy alone: five stages over half a year, one of which begins to hum.
The command is interrupted when a third of the rows is done, and then begun again. What is printed:
how long it took, what was kept, whether the order and the verdicts are right, and who was skipped.
"""

import argparse
import csv
import json
import os
import re
import signal
import subprocess
import sys
import time
from datetime import date, timedelta
from pathlib import Path

import numpy as np
from distributed import LocalCluster

from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_models.model_file import save_model

STAGES, DAYS, FIRST = 5, 180, date(2026, 3, 2)
AGEING, HUMS_FROM = "stage 3", 0.6
"""Which stage hums, and from which part of the time on."""

ROWS, PERIOD_S, NOISE_UM, HUM_UM, HUM_HZ = 600, 1e-3, 2e-3, 0.02, 37.3
DEADLY = "deadly.csv"
INTERRUPTED_AT = 1 / 3

PRELOAD = f"""
import os
import signal

from piezo_identification.diagnosis.many import many_recordings

whole = many_recordings.DiagnosisRow.content


def content(row, whole=whole):
    if row.data[0].name == "{DEADLY}":
        os.kill(os.getpid(), signal.SIGKILL)
    return whole(row)


if whole.__name__ == "content" and whole.__module__ == many_recordings.__name__:
    many_recordings.DiagnosisRow.content = content
"""
"""What each worker runs before it begins."""


def make_fleet(folder, count):
    """Write the model, the recordings and the table of a fleet; return the names of what hums."""
    folder.mkdir(parents=True)
    line = StageModel(PreisachModel.line(0.0, 10.0, 2.0),
                      CreepDynamics(), ElectricVibrationDynamics())
    save_model(folder / "model.json", IdentifiedModel(line, (0.0, 10.0)))
    rng, time_s = np.random.default_rng(1), PERIOD_S * np.arange(ROWS)
    rows, hums = [], set()
    for number in range(count):
        stage, part = f"stage {number % STAGES + 1}", number / count
        voltage_v = np.repeat(rng.uniform(0.0, 10.0, ROWS // 20), 20)
        displacement_um = 2.0 * voltage_v + rng.normal(scale=NOISE_UM, size=ROWS)
        name = f"r{number:03}"
        if stage == AGEING and part >= HUMS_FROM:
            hums.add(name)
            displacement_um += HUM_UM * np.sin(2.0 * np.pi * HUM_HZ * time_s)
        file = DEADLY if number == count // 2 else f"{name}.csv"
        np.savetxt(folder / file, np.column_stack([time_s, voltage_v, displacement_um]),
                   delimiter=",", header="time_s,voltage_v,displacement_um", comments="")
        rows.append(("model.json", file, name, stage, FIRST + timedelta(part * DAYS)))
    with (folder / "table.csv").open("w", newline="") as stream:
        csv.writer(stream).writerows([("model", "data", "name", "stage", "recorded"), *rows])
    return hums


def run(folder, address, interrupt_at=None):
    """Run the command; return how long it took, how it ended, and what it printed."""
    begun_s = time.monotonic()
    process = subprocess.Popen(
        [sys.executable, "-u", "-m", "piezo_offline.piezo_command", "diagnose-many",
         folder / "table.csv", "--scheduler", address, "--output", folder / "diagnoses"],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        # A shell lets what it starts in the background ignore Ctrl-C.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL))
    printed = ""
    for line in process.stdout:
        printed += line
        done = re.search(r"diagnosed (\d+) of", line)
        if done and interrupt_at is not None and int(done[1]) >= interrupt_at:
            process.send_signal(signal.SIGINT)
            interrupt_at = None
    return time.monotonic() - begun_s, process.wait(), printed


def main():
    """Make the fleet, diagnose it twice, and print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recordings", type=int, default=200)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--output", type=Path, default=Path("runs/fleet"))
    options = parser.parse_args()
    folder, count = options.output.absolute(), options.recordings
    hums = make_fleet(folder, count)
    preload = folder / "deadly.py"
    preload.write_text(PRELOAD)
    before = os.times()
    with LocalCluster(n_workers=options.workers, threads_per_worker=1, dashboard_address=None,
                      preload=[str(preload)]) as cluster:
        address = cluster.scheduler_address
        first_s, status, _ = run(folder, address, count * INTERRUPTED_AT)
        kept = len(list(folder.glob("diagnoses/*/content.json")))
        print(f"interrupted after {first_s:.0f} s with exit status {status}: {kept} rows are kept")
        second_s, status, printed = run(folder, address)
    after = os.times()
    with (folder / "diagnoses" / "summary.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    names = [row["name"] for row in rows]
    wrong = [row["name"] for row in rows
             if (row["verdict"] != "none") != (row["name"] in hums)]
    used_s = sum(after[2:4]) - sum(before[2:4])
    print(f"begun again: {second_s:.0f} s, exit status {status}, {printed.count('(done before)')} "
          "rows done before")
    print(f"{len(rows)} of {count} rows diagnosed, in the order of the table: "
          f"{names == sorted(names)}; wrong verdicts: {', '.join(wrong) or 'none'}")
    print("\n".join(line for line in printed.splitlines()
                    if "was skipped" in line or "model lacks an effect" in line or "next:" in line))
    print(json.dumps({"workers": options.workers, "recordings": count, "processor_s": round(used_s),
                      "seconds": round(first_s + second_s)}))


if __name__ == "__main__":
    main()
