# SPDX-License-Identifier: BSD-3-Clause
"""The command `report`: describe the samples of a recording."""

import argparse
from pathlib import Path

from piezo_common.command_line import Command


def _add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recording", type=Path, help="directory, MCAP file or table")


COMMAND = Command(
    "report", "Account for the samples of a recording.", _add_options,
    "piezo_recorder.reading.sample_account:report_file",
    epilog="The status is 1 where samples are missing, 2 where it cannot be read.",
    inputs=("recording",))
main = COMMAND.main
