# SPDX-License-Identifier: BSD-3-Clause
"""`diagnose_suite`: run the benchmark of `diagnose` on plants with hidden effects."""

import argparse
from pathlib import Path

from piezo_common.command_line import Command


def _add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--cases", type=int, default=260, help="how many (%(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of everything random (%(default)s)")
    parser.set_defaults(kind="long")
    parser.add_argument("--short", dest="kind", action="store_const", const="short",
                        help="recordings of seconds, with one effect or none, without experiments")
    parser.add_argument("--all-along", dest="kind", action="store_const", const="all-along",
                        help="single effects alone that were there when the model was identified")
    parser.add_argument("--experiments", type=int, default=0,
                        help="proposed recordings that may be made in each case (%(default)s)")
    parser.add_argument("--first", type=int, metavar="N",
                        help="run the first N of the cases alone; the order samples them")
    parser.add_argument("--scheduler", metavar="ADDRESS",
                        help="of a Dask scheduler, as tcp://host:8786; local processes by default")
    parser.add_argument("--output", type=Path, default=Path("runs/diagnose-suite"),
                        help="directory of table.json, and of the results that are kept, from "
                             "which a run goes on (%(default)s)")
    parser.add_argument("--page", type=Path,
                        help="page whose section on calibration is written again, such as "
                             "docs/studies/diagnosis_rates.md")


COMMAND = Command(
    "diagnose_suite", "Run the cases through Dask, print the confusion table and write it.",
    _add_options, "piezo_studies.diagnosis_benchmark.run_suite:diagnose_cases",
    interrupted="what is done is kept; the same command goes on")
main = COMMAND.main
