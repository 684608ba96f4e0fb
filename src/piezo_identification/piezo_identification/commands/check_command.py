# SPDX-License-Identifier: BSD-3-Clause
"""`check`: the suitability of recordings for experiments, before a model is fitted."""

import argparse
from pathlib import Path

from piezo_common.command_line import Command, add_budget_option, add_report_option
from piezo_recorder.commands.data_flags import FILE_HELP, add_columns_option


def _add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--data", metavar="FILE", type=Path, required=True, nargs="+",
                        help=FILE_HELP)
    parser.add_argument("--output", metavar="DIR", type=Path, default=Path(),
                        help="directory for the page and the pictures, NAME_check.png; by default "
                        "the current")
    add_report_option(parser, "check_report.html in --output")
    add_budget_option(parser)
    add_columns_option(parser)


COMMAND = Command(
    "check", "Report what recordings can be used for.", _add_options,
    "piezo_identification.commands.check_work:check_files",
    epilog="Prints sample period, jitter, noise, drift, ranges, waveform, state at the start, "
    "the visited part of the Preisach plane, and which experiment each can stand for.",
    inputs=("data",), folders=("output",),
    interrupted="what it printed holds, and so do the pictures that it named")
main = COMMAND.main
