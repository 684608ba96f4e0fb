# SPDX-License-Identifier: BSD-3-Clause
"""The command `specimen`: make a grating to be scanned with a simulated stage."""

import argparse
from pathlib import Path

from piezo_common.command_line import Command, check_output_file, print_next


def _add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--centre-um", type=float, nargs=2, default=(20.0, 20.0),
                        metavar=("X", "Y"), help="in coordinates of the stage; 20 20 by default")
    for option, default, text in (("--size-um", 50.0, "length of its sides"),
                                  ("--pitch-um", 2.5, "distance of the pits")):
        parser.add_argument(option, type=float, default=default, metavar="NUMBER",
                            help=f"{text} (default: %(default)g)")
    parser.add_argument("--seed", type=int, default=1, help="of the grains on it")
    parser.add_argument("--output", type=Path, required=True, metavar="FILE",
                        help="Gwyddion Simple Field (.gsf) to write")


def _check(options: argparse.Namespace) -> None:
    check_output_file(options.output)
    if not 0.0 < options.pitch_um <= options.size_um:
        raise ValueError("the pitch is not between 0 and the size: choose another --pitch-um")


def make_specimen(options: argparse.Namespace) -> None:
    """Write the grating."""
    from piezo_common.gsf import write_gsf
    from piezo_sim.specimen.grating import grating

    write_gsf(options.output, grating(
        tuple(options.centre_um), options.size_um, options.pitch_um, options.seed))
    print(f"written {options.output}")
    print_next(options, "piezo_sim", "stage_sim", "--ros-args", "-p", "plant:=xy", "-p",
               f"specimen:={options.output}")


COMMAND = Command("specimen", "Make a grating to be scanned with a simulated stage.", _add_options,
                  "piezo_sim.specimen.specimen_command:make_specimen", check=_check)
main = COMMAND.main
