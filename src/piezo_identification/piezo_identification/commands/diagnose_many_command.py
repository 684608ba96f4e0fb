# SPDX-License-Identifier: BSD-3-Clause
"""`diagnose_many`: diagnose the rows of a table, and summarise the results."""

import argparse
from pathlib import Path

from piezo_common.command_line import Command


def _add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("table", metavar="TABLE", type=Path,
                        help="CSV with the columns model,data and if need be holdout, "
                        "identified_from, name, stage and recorded (a day or a time); a semicolon "
                        "stands between several files")
    parser.add_argument("--scheduler", metavar="ADDRESS",
                        help="of a Dask scheduler, as tcp://host:8786; local processes by default")
    parser.add_argument("--output", metavar="DIR", type=Path, required=True,
                        help="directory for the results, a folder for each row")


COMMAND = Command(
    "diagnose-many", "Diagnose many recordings, and sum up what is found.", _add_options,
    "piezo_identification.diagnosis.many.diagnose_table:diagnose_table",
    epilog="Writes index.html and summary.csv, and for each row what `diagnose` writes. A row that "
    "is done is not done again unless a file of it has changed; one that cannot be diagnosed is "
    "named and skipped.",
    inputs=("table",), folders=("output",),
    interrupted="the rows that were done are kept; begin again to do the others")
main = COMMAND.main
