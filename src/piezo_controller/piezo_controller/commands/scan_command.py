# SPDX-License-Identifier: BSD-3-Clause
"""The command `scan`: from a model of several axes and a path to the voltages that follow it."""

import argparse
from pathlib import Path

from piezo_common.command_line import Command

WITHOUT_FILE = "raster", "spiral", "lissajous", "rosette", "cycloid"
WITH_FILE = "points", "file", "scanspec"
PATTERNS = (*WITHOUT_FILE, *WITH_FILE)


def _add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--model", type=Path, required=True, help="model file of several axes")
    add_path_options(parser, PATTERNS[0])
    parser.add_argument("--output", type=Path, required=True,
                        help="folder for path.csv, begin.csv, scan.json and path.png")


def add_path_options(parser: argparse.ArgumentParser, default: str | None) -> None:
    """Add the options that say which path is planned, and the pattern if none is given."""
    parser.add_argument("--pattern", choices=PATTERNS, default=default,
                        help="kind of the path" + (" (default: %(default)s)" if default else ""))
    parser.add_argument("--file", type=Path,
                        help="of points and file: a CSV with columns such as x_displacement_um, "
                        "and of file time_s; of scanspec: a serialised specification (JSON)")
    parser.add_argument("--size-um", type=float, nargs=2, metavar=("FAST", "SLOW"),
                        help="size of the image, or the two diameters; 10 10 by default")
    parser.add_argument("--axes", nargs=2, metavar=("FAST", "SLOW"),
                        help="axes that the pattern moves; the first two of the model by default")
    parser.add_argument("--centre-um", type=float, nargs=2, metavar=("FAST", "SLOW"),
                        help="centre of the path; the operating point of the model by default")
    parser.add_argument("--rate-hz", type=float,
                        help="lines a second of a raster; turns of a spiral at its fastest, and of "
                        "a cycloid; periods of the first axis of a Lissajous figure; ways of a "
                        "rosette through its centre; points or frames; 10 by default")
    parser.add_argument("--lines", type=int,
                        help="of a raster; turns of a spiral or cycloid; lobes of a rosette; 64 by "
                        "default")
    parser.add_argument("--pixels", type=int, help="of a line; as many as lines by default")
    parser.add_argument("--both-directions", action="store_true", default=None,
                        help="lines of a raster go forward and backward")
    parser.add_argument("--flyback-s", type=float,
                        help="time from the end of a line to the beginning of the next")
    parser.add_argument("--frame-flyback-s", type=float,
                        help="time from the last line to the first")
    parser.add_argument("--linear-velocity", action="store_true", default=None,
                        help="a spiral at constant speed; by default at constant angular velocity")
    parser.add_argument("--voltage-range-v", type=float, nargs=2, metavar=("LOW", "HIGH"),
                        help="of the amplifier; that of the identification by default")
    parser.add_argument("--slew-limit-v-per-s", type=float, help="of the amplifier")
    parser.add_argument("--sensor-delay-s", type=float, nargs="+", metavar="SECONDS",
                        help="by how much the reading of each axis of the model is late, for marks "
                        "and images; as identified by default")


OF_PATTERN = ("size_um", "axes", "centre_um", "rate_hz", "lines", "pixels", "both_directions",
              "flyback_s", "frame_flyback_s", "linear_velocity")
OF_FILE = {"points": ("rate_hz",), "file": (), "scanspec": ("rate_hz", "flyback_s")}
"""Options that say how a pattern is drawn, and those of them that a path of a file takes."""


def check_path_options(options: argparse.Namespace) -> None:
    """Raise ValueError if a pattern lacks its file, or has a file or an option without effect."""
    if (options.file is None) == (options.pattern in WITH_FILE):
        raise ValueError(f"a {options.pattern} " + (
            "needs a file: give --file" if options.file is None else
            "takes no file: leave --file out, or give --pattern file"))
    taken = OF_FILE.get(options.pattern, OF_PATTERN)
    ignored = [f"--{name.replace('_', '-')}" for name in OF_PATTERN
               if name not in taken and getattr(options, name) is not None]
    if ignored:
        raise ValueError(f"the path of {options.file} has its own positions: leave out "
                         f"{', '.join(ignored)}")


def _check(options: argparse.Namespace) -> None:
    check_path_options(options)
    if options.output.exists() and not options.output.is_dir():
        raise ValueError(f"{options.output} is a file: choose a folder for --output")


COMMAND = Command(
    "scan", "Plan the voltages by which several axes follow a path, and predict how well.",
    _add_options, "piezo_controller.commands.scan_work:plan_scan", inputs=("model", "file"),
    folders=("output",), check=_check)
main = COMMAND.main
