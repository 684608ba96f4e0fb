# SPDX-License-Identifier: BSD-3-Clause
"""The command `convert`: rewrite any recording in the format of this suite, or as CSV."""

import argparse
from pathlib import Path

from piezo_common.command_line import Command
from piezo_recorder.commands.data_flags import FILE_HELP, add_columns_option


def _add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recording", metavar="FILE", type=Path, help=FILE_HELP)
    parser.add_argument("output", metavar="NEW", type=Path,
                        help="file to make if it ends in .csv, else the directory of a recording")
    add_columns_option(parser)


def _check(options: argparse.Namespace) -> None:
    output = options.output
    if output.exists():
        raise ValueError(f"{output} exists already and is not overwritten: choose another name")
    if not output.absolute().parent.is_dir():
        raise ValueError(f"{output} is in no existing directory: make it first")


COMMAND = Command(
    "convert", "Write a table of samples or a recording in our formats.", _add_options,
    "piezo_recorder.writing.convert:convert_file",
    epilog="Several recordings of one file become NEW_1, NEW_2 and so on, by their titles.",
    inputs=("recording",), check=_check,
    interrupted="NEW, if it is there, is incomplete: remove it")
main = COMMAND.main
