# SPDX-License-Identifier: BSD-3-Clause
"""The command `repair`: make a complete recording from that of a killed recorder."""

import argparse
from pathlib import Path

from piezo_common.command_line import Command


def _add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recording", type=Path, help="directory or MCAP file; it stays as it is")
    parser.add_argument("output", type=Path, help="directory to make")


COMMAND = Command(
    "repair", "Make a complete recording from the files of a killed recorder.", _add_options,
    "piezo_recorder.writing.repair:repair_given", inputs=("recording",),
    interrupted="the output, if it is there, is incomplete: remove it")
main = COMMAND.main
