# SPDX-License-Identifier: BSD-3-Clause
"""`measured`: errors on measured data of other stages, compared with published figures."""

import argparse
from pathlib import Path

from piezo_common.command_line import Command


def _add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--data", metavar="DIR", type=Path, required=True,
                        help="directory of the measured sets")
    parser.add_argument("--output", metavar="DIR", type=Path, default=Path("runs/measured"),
                        help="directory for table.json and pictures (default: %(default)s)")


COMMAND = Command(
    "measured", "Identify stages from measured data, and print the error on data that was not "
    "fitted next to the figures in the data's note.", _add_options,
    "piezo_studies.measured_devices.measured_work:measure_devices", inputs=("data",),
    interrupted="table.json, if it is new, has the sets before this one")
main = COMMAND.main
