# SPDX-License-Identifier: BSD-3-Clause
"""Diagnose the rows of a table, and write and print the results, for `diagnose_many`."""

import argparse
import csv
import sys
from collections.abc import Sequence
from typing import Any

from piezo_common.command_line import print_next, print_progress
from piezo_identification.diagnosis.many.fleet import histories
from piezo_identification.diagnosis.many.many_page import HEADS, many_page, summary_row
from piezo_identification.diagnosis.many.many_recordings import (
    DiagnosisRow,
    cluster_client,
    diagnose_rows,
    errors_of,
    read_table,
)


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
