# SPDX-License-Identifier: BSD-3-Clause
"""The option that sets when a logger reads the displacement of a row."""

import argparse

READINGS = {"start": 0.0, "end": 1.0}
"""Reading times, in sample periods after the change of the voltage of a row."""


def add_rows_option(parser: argparse.ArgumentParser) -> None:
    """Add ``--rows-read``."""
    parser.add_argument(
        "--rows-read", choices=tuple(READINGS), default="start",
        help="when the displacement of a row is read: as its voltage changes (default), or at the "
        "end of the hold, just before the next voltage")
