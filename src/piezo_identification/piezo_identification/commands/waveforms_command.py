# SPDX-License-Identifier: BSD-3-Clause
"""`waveforms`: the voltages of the experiments as CSV, for instruments of any make."""

import argparse
from pathlib import Path

from piezo_common.command_line import Command

USUAL = ("sweep", "creep", "dynamics", "hysteresis", "validation")
NAMES = (*USUAL, "multisine", "diagnostic", "distortion")


def _add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--directory", metavar="DIR", type=Path, required=True,
                        help="where the files go, NAME.csv")
    parser.add_argument("--range", metavar=("LOWEST", "HIGHEST"), type=float, nargs=2,
                        required=True, help="of the voltage (V)")
    parser.add_argument("--rate", metavar="HZ", type=float, required=True,
                        help="sample rate of the instrument; slow experiments hold their values")
    parser.add_argument("--rest", metavar="V", type=float,
                        help="voltage before and after; by default 0, or the end of the range "
                        "that is nearest to it")
    parser.add_argument("--ramp-rate", metavar="V/S", type=float, default=2000.0,
                        help="of the way from rest and back; by default 2000")
    parser.add_argument("--slew-limit", metavar="V/S", type=float, default=2e6,
                        help="of the amplifier: the largest jump within a sample; by default 2e6")
    parser.add_argument("--levels", metavar="NUMBER", type=int,
                        help="harmonics of the hysteresis, each of 2 s; by default 70")
    parser.add_argument("--experiments", metavar="NAME", nargs="+", choices=NAMES,
                        default=list(USUAL),
                        help=f"of {', '.join(NAMES)}; by default {', '.join(USUAL)}")
    parser.add_argument("--force", action="store_true",
                        help="write over files that are there already")


def _check(options: argparse.Namespace) -> None:
    lowest_v, highest_v = options.range
    if not lowest_v < highest_v:
        raise ValueError(f"--range {lowest_v:g} {highest_v:g} is empty: give the lower end first")
    for name in ("rate", "ramp_rate", "slew_limit"):
        if not 0.0 < getattr(options, name) < float("inf"):
            raise ValueError(f"--{name.replace('_', '-')} {getattr(options, name):g} is not above "
                             "0: give a positive number")
    if options.levels is not None and not 2 <= options.levels <= 300:
        raise ValueError(f"--levels {options.levels} is not within 2 to 300: give one that is")
    if options.rest is not None and not lowest_v <= options.rest <= highest_v:
        raise ValueError(f"--rest {options.rest:g} is outside the range: give one within")
    there = [path for path in waveform_paths(options).values() if path.exists()]
    if there and not options.force:
        raise ValueError(f"{', '.join(map(str, there))} exists already and is not overwritten: "
                         "choose another --directory, or give --force")


def waveform_paths(options: argparse.Namespace) -> dict[str, Path]:
    """Return the files of the selected experiments by name."""
    return {name: options.directory / f"{name}.csv" for name in options.experiments}


COMMAND = Command(
    "waveforms", "Write the voltages of the experiments as CSV.", _add_options,
    "piezo_identification.commands.waveforms_work:write_waveforms",
    epilog="Each file has the columns time_s and voltage_v, from rest and back. Play it, and put "
    "the displacement in a further column: `check` and `identify` read the result.",
    check=_check, folders=("directory",), interrupted="the files that it named are complete")
main = COMMAND.main
