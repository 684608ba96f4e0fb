# SPDX-License-Identifier: BSD-3-Clause
"""`identify`: from recordings to a model file."""

import argparse
from pathlib import Path

from piezo_common.command_line import (
    Command,
    add_budget_option,
    add_report_option,
    check_output_file,
)
from piezo_identification.commands.response_options import add_response_options, add_rows_option
from piezo_recorder.commands.data_flags import add_columns_option

EXPERIMENTS = {
    "creep": "long square wave, or any other slow voltage, such as steps or trapezoids",
    "dynamics": "short square wave, or any other fast voltage, at the full sample clock, or a "
    "frequency response (CSV frequency_hz,gain_re,gain_im, or the export of an analyser)",
    "hysteresis": "harmonics of rising amplitude from the lowest voltage, or any other loops",
    "validation": "any other input: the errors are measured on it",
}
PURPOSES = {"sweep": "hysteresis", "multisine": "dynamics", "diagnostic": "dynamics",
            "distortion": "dynamics"}
"""Further waveforms of `waveforms`, and the experiment that each can replace."""


def _add_options(parser: argparse.ArgumentParser) -> None:
    for name, help_text in EXPERIMENTS.items():
        if name == "validation":
            parser.add_argument(f"--{name}", metavar="FILE", type=Path, help=help_text)
            continue
        parser.add_argument(f"--{name}", metavar="FILE", type=Path, help=help_text, nargs="+",
                            action="extend")
    for name, purpose in PURPOSES.items():
        parser.add_argument(f"--{name}", metavar="FILE", type=Path, nargs="+", action="extend",
                            dest=purpose, help=f"the same as --{purpose}: a recording of the "
                            f"waveform {name}")
    parser.add_argument("--anyway", action="store_true",
                        help="go on with a recording that looks like one of another experiment")
    parser.add_argument("--output", metavar="MODEL", type=Path, required=True,
                        help="model file to write")
    parser.add_argument("--refine", action="store_true",
                        help="of earlier versions: identify always fits all components together "
                        "at the end")
    parser.add_argument("--method", choices=("output-error", "armax"), default="output-error",
                        help="of earlier versions: all are fitted by their output error")
    for name, what in (("creep-pairs", "pole and zero pairs of the creep"),
                       ("modes", "vibration modes"),
                       ("antiresonances", "antiresonances of a frequency response")):
        parser.add_argument(f"--{name}", metavar="NUMBER", type=int, choices=range(11),
                            help=f"number of {what}; by default chosen from the data")
    parser.add_argument("--band", metavar=("LOW_HZ", "HIGH_HZ"), type=float, nargs=2,
                        help="part of a frequency response to fit; by default all of it")
    parser.add_argument("--verbose", action="store_true",
                        help="print all parameters, and what was tried")
    add_report_option(parser, "MODEL_report.html next to the model")
    add_budget_option(parser)
    add_columns_option(parser)
    parser.add_argument("--grid", metavar="CELLS", type=int,
                        help="cells of the hysteresis along each threshold, 4 to 300; by default "
                        "two for each of up to 70 levels that the voltage passes by")
    parser.add_argument("--smoothing", metavar="WEIGHT", type=float,
                        help="weight of the curvature of the hysteresis' density, such as 1e-10; "
                        "by default chosen on branches held out")
    parser.add_argument("--translation-weight", metavar="WEIGHT", type=float,
                        help="weight of the density's change along the diagonal, which lets loops "
                        "of one width be alike; by default 0")
    add_rows_option(parser)
    add_response_options(parser)


def _check(options: argparse.Namespace) -> None:
    check_output_file(options.output)
    if all(getattr(options, name) is None for name in ("creep", "dynamics", "hysteresis")):
        raise ValueError(
            "there is nothing to identify: give --creep, --dynamics or --hysteresis")


COMMAND = Command(
    "identify", "Identify a stage model from recordings.", _add_options,
    "piezo_identification.commands.identify_work:identify_files",
    epilog="FILE is a recording (a rosbag2 directory or an .mcap), or a table whose rows are "
    "samples at their instants: text, .mat, .h5, .npz, .tdms, .parquet and others. Give one or "
    "more FILEs of at least one kind. Without --creep the model does not creep; without "
    "--dynamics it answers at once; without --hysteresis that of the others is taken.",
    inputs=tuple(EXPERIMENTS), check=_check, interrupted="no model was written")
main = COMMAND.main
