# SPDX-License-Identifier: BSD-3-Clause
"""`demo`: identify a simulated stage, track, diagnose, track again, watch, decide, scan, report."""

import argparse
from pathlib import Path

from piezo_common.command_line import Command
from piezo_sim.plant.named_plants import PLANTS

USUAL = "undeclared"
"""Default plant of the demo."""


def _add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--plant", default=USUAL, metavar="PLANT",
                        help=f"the stage: {', '.join(PLANTS)}, or a plant file "
                             "(default: %(default)s)")
    parser.add_argument("--output", type=Path, metavar="DIRECTORY",
                        help="gets all results (default: runs/demo, and runs/demo-PLANT for any "
                             "other stage than the usual one); an earlier run there is moved aside")
    parser.add_argument("--first-part", action="store_true",
                        help="without the stage that changes while it tracks, the recording that "
                             "decides, and the scan of two axes")


COMMAND = Command(
    "demo", "Identify a simulated stage, track with the model, find what the model lacks, track "
    "again with the extended model, watch a change, decide a cause, scan with two axes, and "
    "report.", _add_options, "piezo_studies.demo.demo_node:run_given")
main = COMMAND.main
