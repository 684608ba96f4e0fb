# SPDX-License-Identifier: BSD-3-Clause
"""`simulate`: compare the displacement of a model with that of a recording."""

import argparse
from pathlib import Path

from piezo_common.command_line import Command, add_report_option
from piezo_identification.commands.response_options import add_rows_option
from piezo_recorder.commands.data_flags import FILE_HELP, add_columns_option


def _add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--model", metavar="MODEL", type=Path, required=True, help="model file")
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--data", metavar="FILE", type=Path, help=FILE_HELP)
    source.add_argument("--voltage", metavar="FILE", type=Path,
                        help="a voltage of which nothing was measured: CSV with the columns "
                        "time_s,voltage_v; predicted.csv in --output has the displacement")
    parser.add_argument("--output", metavar="DIR", type=Path,
                        help="directory for the page and the pictures; none are drawn without it")
    add_report_option(parser, "simulation_report.html in --output")
    add_columns_option(parser)
    add_rows_option(parser)


def _check(options: argparse.Namespace) -> None:
    if options.voltage and not options.output:
        raise ValueError("--voltage needs --output: give the directory of predicted.csv")
    if options.voltage and (options.columns or options.rows_read != "start"):
        raise ValueError("--columns and --rows-read have nothing to act on with --voltage: leave "
                         "them out")


COMMAND = Command(
    "simulate", "Simulate a model under the voltage of a recording, or under a voltage alone.",
    _add_options,
    "piezo_identification.commands.simulate_work:simulate_file",
    epilog="e_y (4.20) is the relative error by the sensor; offset, initial creep and the "
    "past of the hysteresis are fitted as far as the recording does not determine them.",
    check=_check, inputs=("model", "data", "voltage"), folders=("output",),
    interrupted="pictures that it named are whole")
main = COMMAND.main
