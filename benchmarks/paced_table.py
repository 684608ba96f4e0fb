# SPDX-License-Identifier: BSD-3-Clause
"""Pace the loop on board, idle and busy, and write its table: python paced_table.py [SECONDS].

The time is run in pieces. Each leaves a line in a file at once, so that a run that was interrupted
goes on with the pieces that are missing. Those of another commit or machine do not count.
"""

import argparse
import math
import os
import platform
import subprocess
import tempfile
from pathlib import Path

from bare_timer import PRIORITY
from paced_onboard import onboard_run

from piezo_studies.kept_results import KeptResults
from piezo_studies.marked_sections import write_sections

SECTION = "paced loop on board"
"""Mark of the table in the page."""

BUSY_PROCESSES = 2
LOADS = {0: "idle", BUSY_PROCESSES: f"{BUSY_PROCESSES} processes that compute all the while"}
SUMMED = ("ticks", "lost_samples", "missed_feedback", "without_feedback", "missed_deadlines",
          "counted_ticks", "bare_wakes", "bare_late")


def piece_of(run):
    """Return what a run leaves in the file."""
    return {"ticks": run.ticks, "lost_samples": run.lost_samples,
            "missed_feedback": run.missed_feedback,
            "without_feedback": run.ticks - run.fed_back_ticks,
            "missed_deadlines": run.missed_deadlines, "counted_ticks": run.counted_ticks,
            "longest_wait_ms": float(run.described["longest_wait_of_a_tick_ms"]),
            "bare_wakes": run.bare_timer["wakes"], "bare_late": run.bare_timer["late"],
            "bare_latest_ms": run.bare_timer["latest_ms"],
            "real_time": run.described["real_time"], "histogram": run.histogram}


def conditions_of(busy, piece_s):
    """Return what two pieces must have in common to count together."""
    commit = subprocess.run(["git", "rev-parse", "HEAD"], cwd=Path(__file__).parent,
                            capture_output=True, text=True, check=False).stdout.strip()
    return {"busy": busy, "piece_s": piece_s, "priority": PRIORITY, "commit": commit,
            "machine": f"{platform.node()} {platform.machine()}", "cores": os.cpu_count()}


def total(pieces, piece_s):
    """Return the sum of pieces: of their counts, of their histograms; the largest of the rest."""
    summed = {name: sum(piece[name] for piece in pieces) for name in SUMMED}
    histogram = {bound: sum(piece["histogram"].get(bound, 0) for piece in pieces)
                 for piece in pieces for bound in piece["histogram"]}
    return summed | {
        "histogram": histogram,
        "longest_wait_ms": max(piece["longest_wait_ms"] for piece in pieces),
        "bare_latest_ms": max(piece["bare_latest_ms"] for piece in pieces),
        "real_time": "; ".join(sorted({piece["real_time"] for piece in pieces})),
        "seconds": piece_s * len(pieces), "cores": os.cpu_count()}


def table(totals):
    """Return the table as Markdown, of totals by the number of busy processes."""
    columns = list(totals.values())
    cores = columns[0]["cores"]

    def row(name, cell):
        return [name, *(cell(column) for column in columns)]

    rows = [
        [f"at 1 kHz, {cores} cores", *(LOADS[busy] for busy in totals)],
        ["---"] * (1 + len(columns)),
        row("time", lambda of: f"{of['seconds']:g} s"),
        row("ticks of the run", lambda of: f"{of['ticks']}"),
        row("samples lost", lambda of: f"{of['lost_samples']}"),
        row("feedback values late or missing",
            lambda of: f"{of['missed_feedback'] + of['without_feedback']}"),
        row("ticks that missed their deadline", lambda of: (
            f"{of['missed_deadlines']} of {of['counted_ticks']}, "
            f"{_percent(of['missed_deadlines'], of['counted_ticks'])}")),
        row("longest wait of a tick", lambda of: f"{of['longest_wait_ms']:.3g} ms"),
        row("wakes of a bare timer that came late by a tick", lambda of: (
            f"{_percent(of['bare_late'], of['bare_wakes'])}, at most by "
            f"{of['bare_latest_ms']:.3g} ms"))]
    for bound in columns[0]["histogram"]:
        rows.append(row(f"ticks begun {bound}", lambda of, bound=bound: _percent(
            of["histogram"].get(bound, 0), of["counted_ticks"])))
    rows.append(row("priority and memory", lambda of: of["real_time"]))
    return "".join("| " + " | ".join(cells) + " |\n" for cells in rows)


def _percent(part, whole):
    return f"{100.0 * part / whole:.3g} %"


def main():
    """Run what is missing, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("seconds", type=float, nargs="?", default=600.0, help="of each load")
    parser.add_argument("--piece", type=float, default=60.0, help="longest piece (s)")
    parser.add_argument("--output", type=Path, default=Path("runs/paced"),
                        help="directory of the file of pieces, from which a run goes on")
    parser.add_argument("--page", type=Path, default=Path("docs/studies/paced_loop.md"),
                        help="page whose table is written anew; its text stays")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    piece_s = min(options.piece, options.seconds)
    wanted = max(1, math.ceil(options.seconds / piece_s))
    totals = {}
    for busy in LOADS:
        file = KeptResults(options.output / "pieces.jsonl", conditions_of(busy, piece_s))
        pieces = file.results()
        for number in range(wanted):
            if number in pieces:
                continue
            print(f"{LOADS[busy]}: piece {number + 1} of {wanted} ...", flush=True)
            with tempfile.TemporaryDirectory() as directory:
                pieces[number] = piece_of(onboard_run(Path(directory), piece_s, busy))
            file.add(number, pieces[number])
        totals[busy] = total([pieces[number] for number in range(wanted)], piece_s)
    write_sections(options.page, {SECTION: table(totals)})
    print(table(totals))


if __name__ == "__main__":
    main()
