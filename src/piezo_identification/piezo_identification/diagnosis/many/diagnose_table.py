# SPDX-License-Identifier: BSD-3-Clause
"""Diagnose the rows of a table, write and print what they come to: the work of `diagnose_many`."""

import argparse
import csv
import sys

from piezo_common.command_line import print_progress
from piezo_identification.diagnosis.many.many_page import HEADS, many_page, summary_row
from piezo_identification.diagnosis.many.many_recordings import (
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
    cells = [summary_row(result) for result in results if "verdict" in result]
    page.write_text(many_page(results, [f"table {options.table}"]), encoding="utf-8")
    with table.open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream).writerows([HEADS, *cells])
    for result in results:
        if "verdict" in result:
            name, verdict, effects, *_ = summary_row(result)
            again = "" if result["is_new"] else " (done before)"
            print(f"{name}: {verdict} {effects}".rstrip() + again)
    for sentence in errors_of(results):
        print(f"{options.prog}: {sentence}", file=sys.stderr)
    print(f"report: {page}")
