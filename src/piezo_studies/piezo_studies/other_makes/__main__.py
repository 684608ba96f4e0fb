# SPDX-License-Identifier: BSD-3-Clause
"""Identify stages of other makes as a laboratory would, and print a table of the errors."""

import argparse
import json
import os
import signal
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

from piezo_studies.other_makes.makes import MAKES
from piezo_studies.other_makes.recordings import UNSEEN
from piezo_studies.other_makes.trial import OUTCOME, Outcome, failed, read_outcome

TABLE, PRINTED = "other_makes.json", "printed.txt"
CLOCK_PER_CPU = 10.0
"""Largest ratio of wall time to processor time of a trial."""


def main(arguments: list[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="other_makes", description=__doc__)
    parser.add_argument("--stage", nargs="+", choices=MAKES, default=tuple(MAKES))
    parser.add_argument("--seed", type=int, nargs="+", default=(0,),
                        help="of drawn parameters and noise; 0, the default, is the nominal stage")
    parser.add_argument("--output", type=Path, default=Path("runs/other-makes"),
                        help="folder of recordings, models and the table; recordings that it has "
                        "are taken as they are")
    parser.add_argument("--diagnose", action="store_true",
                        help="diagnose the mixed motion, too")
    parser.add_argument("--cpu-minutes", type=int, default=20, metavar="MINUTES",
                        help="time of the processor after which a stage is ended; ten times as "
                        "much of the clock ends one that hangs")
    options = parser.parse_args(arguments)
    print(heading())
    outcomes = {}
    for seed in options.seed:
        for stage in options.stage:
            name = f"{stage}-{seed}" if seed else stage
            outcomes[name] = in_own_process(stage, seed, options.output / name, options.diagnose,
                                            options.cpu_minutes)
            print(row(name, outcomes[name]), flush=True)
            (options.output / TABLE).write_text(
                json.dumps({each: asdict(outcome) for each, outcome in outcomes.items()},
                           indent=1), encoding="utf-8")


def in_own_process(stage: str, seed: int, folder: Path, is_diagnosed: bool,
                   cpu_minutes: int) -> Outcome:
    """Run a trial in a separate process; terminate it with all its children after a time limit."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / OUTCOME).unlink(missing_ok=True)
    command = [sys.executable, "-u", "-m", "piezo_studies.other_makes.trial", "--stage", stage,
               "--seed", str(seed), "--folder", str(folder), "--cpu-minutes", str(cpu_minutes)]
    with (folder / PRINTED).open("w", encoding="utf-8") as printed:
        process = subprocess.Popen([*command, *(["--diagnose"] if is_diagnosed else [])],
                                   stdout=printed, stderr=subprocess.STDOUT,
                                   start_new_session=True)
        try:
            process.wait(60.0 * CLOCK_PER_CPU * cpu_minutes)
        except subprocess.TimeoutExpired:
            return failed(f"hung: ended after {CLOCK_PER_CPU * cpu_minutes:g} min")
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
    if process.returncode == -signal.SIGXCPU:
        return failed(f"ended after {cpu_minutes} min of the processor")
    if process.returncode < 0:
        return failed(f"killed by {signal.Signals(-process.returncode).name}: run it again")
    if not (folder / OUTCOME).exists():
        last = (folder / PRINTED).read_text(encoding="utf-8").strip().splitlines()[-1:]
        return failed("".join(last) or f"status {process.returncode}")
    return read_outcome(folder / OUTCOME)


def heading() -> str:
    """Return the first lines of the table."""
    columns = ["stage", "CPU", *(f"{name} % (noise)" for name in UNSEEN), "called inadequate",
               "intervals that hold", "diagnosis"]
    return f"| {' | '.join(columns)} |\n|{'---|' * len(columns)}"


def row(name: str, outcome: Outcome) -> str:
    """Return the table row of a stage; errors well above the noise are bold."""
    if outcome.failure:
        return f"| {name} | {outcome.failure} |"
    errors = []
    for motion in UNSEEN:
        error = f"{outcome.errors_percent[motion]:.3g}"
        errors.append(f"{error if outcome.is_small(motion) else f'**{error}**'} "
                      f"({outcome.noise_percent[motion]:.2g})")
    holding = sum(each.holds for each in outcome.intervals)
    cells = [name, f"{outcome.cpu_s:.0f} s", *errors, ", ".join(outcome.inadequate) or "none",
             f"{holding} of {len(outcome.intervals)}",
             f"{outcome.verdict}, {outcome.diagnosis_cpu_s:.0f} s" if outcome.verdict else ""]
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    main()
