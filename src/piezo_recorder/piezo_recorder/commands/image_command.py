# SPDX-License-Identifier: BSD-3-Clause
"""The command `image`: make images from the recordings of scans."""

import argparse
from pathlib import Path

from piezo_common.command_line import Command


def _add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--data", type=Path, nargs="+", required=True, metavar="FILE",
                        help="recordings of scans, as `stage scan` makes them")
    parser.add_argument("--signal", default="", metavar="NAME",
                        help="detector; the first one by default")
    parser.add_argument("--specimen", type=Path, metavar="FILE",
                        help="what the images show (.gsf), to tell their geometric error")
    parser.add_argument("--output", type=Path, required=True, metavar="DIR",
                        help="folder for the images and report.html")


COMMAND = Command(
    "image", "Make images from recordings of scans, by the measured positions.", _add_options,
    "piezo_recorder.images.image_page:make_images", inputs=("data", "specimen"),
    folders=("output",))
main = COMMAND.main
