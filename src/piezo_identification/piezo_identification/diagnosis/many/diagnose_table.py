# SPDX-License-Identifier: BSD-3-Clause
"""Diagnose the rows of a table, and write and print the results, for `diagnose_many`."""

import argparse
import csv
import sys
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from piezo_common.command_line import print_next, print_progress
from piezo_common.picture_style import CURVES, label, new_figure
from piezo_common.report_page import Section, pictured, render_page
from piezo_identification.diagnosis.many.many_recordings import (
    DiagnosisRow,
    cluster_client,
    diagnose_rows,
    errors_of,
    read_table,
)

HEADS = ("name", "verdict", "effects", "most probable", "probability", "before (nm)", "after (nm)",
         "noise (nm)")

FLEET_HEADS = ("stage", "recordings", "from", "to", "last verdict", "effects", "since",
               "error, first (nm)", "error, last (nm)")



@dataclass(frozen=True)
class StageHistory:
    """Diagnoses of one stage, the oldest recording first."""

    stage: str
    recorded: tuple[datetime, ...]
    verdicts: tuple[dict[str, Any], ...]

    @property
    def since(self) -> datetime | None:
        """Time since when each recording shows that the model lacks something, or None."""
        poor = [verdict["verdict"] != "none" for verdict in self.verdicts]
        fine = [number for number, is_poor in enumerate(poor) if not is_poor]
        begin = fine[-1] + 1 if fine else 0
        return self.recorded[begin] if begin < len(poor) else None

    def errors_nm(self) -> list[float]:
        """Return the RMS error of the model in each recording."""
        return [1e3 * verdict["before"]["rms_um"] for verdict in self.verdicts]

    def row(self) -> list[str]:
        """Return the cells of the stage, in the order of `FLEET_HEADS`."""
        last, errors_nm = self.verdicts[-1], self.errors_nm()
        return [self.stage, str(len(self.verdicts)), _day(self.recorded[0]),
                _day(self.recorded[-1]), last["verdict"],
                ", ".join(effect["name"] for effect in last["effects"]),
                "" if self.since is None else _day(self.since),
                f"{errors_nm[0]:.3g}", f"{errors_nm[-1]:.3g}"]


def histories(rows: Sequence[DiagnosisRow],
              results: Sequence[dict[str, Any]]) -> list[StageHistory]:
    """Return the history of each stage, those with the longest lack first.

    Rows without a stage or a time of recording are omitted. The results are in the order of the
    rows.
    """
    of_stages: dict[str, list[tuple[datetime, dict[str, Any]]]] = defaultdict(list)
    for row, result in zip(rows, results, strict=True):
        if row.stage and row.recorded and "verdict" in result:
            of_stages[row.stage].append((row.recorded, result["verdict"]))
    found = []
    for stage, entries in of_stages.items():
        entries.sort(key=lambda entry: entry[0])
        times, verdicts = zip(*entries, strict=True)
        found.append(StageHistory(stage, times, verdicts))
    return sorted(found, key=lambda each: (each.since is None, each.since or each.recorded[0]))


def fleet_section(found: Sequence[StageHistory]) -> Section:
    """Return the section of a page that compares the stages."""
    poor = sum(each.since is not None for each in found)
    return Section("Stages", [
        f"{poor} of {len(found)} stages show an effect that their model lacks. Since: the first "
        "recording from which on each of a stage does. Error: RMS of the given model."],
        [FLEET_HEADS, *(each.row() for each in found)],
        [pictured("Errors of the stages", fleet_figure(found),
                  "Error of the model in each recording; filled where the model lacks an effect.",
                  wide=True)])


def fleet_figure(found: Sequence[StageHistory]) -> Figure:
    """Draw the error of each stage's model over time."""
    figure = new_figure(4.2)
    axes = figure.subplots()
    first = min(each.recorded[0] for each in found)
    for number, each in enumerate(found):
        style = CURVES[number % len(CURVES)]
        days = np.array([(time - first) / timedelta(days=1) for time in each.recorded])
        errors_nm = np.array(each.errors_nm())
        axes.semilogy(days, errors_nm, label=each.stage, **style)
        is_poor = np.array([verdict["verdict"] != "none" for verdict in each.verdicts])
        for chosen, face in ((is_poor, style["color"]), (~is_poor, "white")):
            axes.plot(days[chosen], errors_nm[chosen], linestyle="none", marker="o",
                      color=style["color"], markerfacecolor=face)
    axes.legend(fontsize="small")
    label(axes, f"days since {_day(first)}", "RMS error of the model (nm)")
    return figure


def _day(time: datetime) -> str:
    return time.date().isoformat()


def many_page(rows: Sequence[DiagnosisRow], results: Sequence[dict[str, Any]],
              origin: Sequence[str]) -> str:
    """Return the page of many diagnoses, in the order of the rows, as HTML; a fleet first."""
    verdicts = [result for result in results if "verdict" in result]
    counts = Counter(result["verdict"]["verdict"] for result in verdicts)
    effects = Counter(entry["name"] for result in verdicts
                      for entry in result["verdict"]["effects"])
    counted = ", ".join(f"{count} {name}" for name, count in counts.most_common()) or "none"
    skipped = list(errors_of(results))
    of_stages = histories(rows, results)
    sections = [fleet_section(of_stages)] if of_stages else []
    sections += [Section(
        "Recordings", [f"The report of each row is `report.html` in the folder of its name. "
                       f"{len(skipped)} could not be diagnosed."],
        [HEADS, *map(summary_row, verdicts)])]
    if effects:
        sections.append(Section("Effects", table=[
            ("effect", "recordings"),
            *((name, str(count)) for name, count in effects.most_common())]))
    if skipped:
        sections.append(Section("Skipped", skipped))
    return render_page(f"{len(verdicts)} of {len(results)} diagnosed: {counted}", origin, sections)


def summary_row(result: dict[str, Any]) -> list[str]:
    """Return the cells of one diagnosis, in the order of `HEADS`."""
    verdict = result["verdict"]
    chances = verdict.get("probabilities") or {}
    likely = max(chances, key=lambda name: chances[name], default="")
    return [result["name"], verdict["verdict"],
            ", ".join(entry["name"] for entry in verdict["effects"]), likely,
            f"{chances[likely]:.3f}" if likely else "",
            *(f"{1e3 * each:.3g}" for each in (
                verdict["before"]["rms_um"], verdict["after"]["rms_um"],
                verdict["noise_floor_um"]))]


def diagnose_table(options: argparse.Namespace) -> None:
    """Diagnose the rows of the table of the options; write the page and print the rows."""
    rows = read_table(options.table, options.output)
    options.output.mkdir(parents=True, exist_ok=True)
    with cluster_client(options.scheduler) as client:
        try:
            results = diagnose_rows(client, rows, lambda done: print_progress(
                f"diagnosed {done} of {len(rows)}", done / len(rows)))
        finally:
            if client.cluster is not None:
                client.cluster.close()
    page, table = options.output / "index.html", options.output / "summary.csv"
    cells = [[*summary_row(result), row.stage, row.recorded.isoformat() if row.recorded else ""]
             for row, result in zip(rows, results, strict=True) if "verdict" in result]
    page.write_text(many_page(rows, results, [f"table {options.table}"]), encoding="utf-8")
    with table.open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream).writerows([[*HEADS, "stage", "recorded"], *cells])
    for result in results:
        if "verdict" in result:
            name, verdict, effects, *_ = summary_row(result)
            again = "" if result["is_new"] else " (done before)"
            print(f"{name}: {verdict} {effects}".rstrip() + again)
    for each in histories(rows, results):
        if each.since is not None:
            print(f"stage {each.stage}: its model lacks an effect since {each.since.date()}")
    for sentence in errors_of(results):
        print(f"{options.prog}: {sentence}", file=sys.stderr)
    print(f"report: {page}")
    _print_next(options, rows, results)


def _print_next(options: argparse.Namespace, rows: Sequence[DiagnosisRow],
                results: Sequence[dict[str, Any]]) -> None:
    """Print the next command: for the model with the largest error, or a feedback if none lacks."""
    poor = [(result["verdict"]["before"]["rms_um"], number)
            for number, result in enumerate(results)
            if "verdict" in result and result["verdict"]["verdict"] != "none"]
    if not poor:
        print_next(options, "piezo_controller", "design", "--model", rows[0].model, "--output",
                   options.output / "controller.json")
        return
    row = rows[max(poor)[1]]
    print_next(options, "piezo_identification", "propose", "--model", row.model, "--verdict",
               row.directory / "verdict.json", "--data", *row.data, "--output",
               row.directory / "next")
