# SPDX-License-Identifier: BSD-3-Clause
"""The command `design`: from a model file to a controller or law file, with report and figures."""

import argparse
from pathlib import Path

from piezo_common.command_line import Command, add_report_option, check_output_file
from piezo_controller.feedback.synthesis.design_choices import (
    ALL,
    DEFAULT_WEIGHTS,
    DISTURBANCE_HZ,
    FEEDBACKS,
    METHODS,
    PEAK_SENSITIVITY,
    SAMPLE_RATE_HZ,
    SCALINGS,
)

OF_A_TICK = ("method", "weights", "scaling", "full_order", "at_once", "delay_ticks",
             "samples_per_tick")
"""Options that do not apply to a law that answers every sample."""


def _add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--model", type=Path, required=True,
                        help="model file; that of several axes gives a law for a stage that "
                        "evaluates it by itself")
    parser.add_argument("--method", choices=METHODS, default=METHODS[0],
                        help="how to design: %(choices)s")
    parser.add_argument("--feedback", choices=(*FEEDBACKS, ALL),
                        help="a law that answers every sample instead, for a stage that evaluates "
                        "it by itself: %(choices)s, which are then compared")
    parser.add_argument("--peak-sensitivity", type=float, default=PEAK_SENSITIVITY, metavar="MS",
                        help="of --feedback: the margin of all of them, with all parameters off by "
                        "5 %% (default: %(default)g)")
    parser.add_argument("--weights", default=DEFAULT_WEIGHTS,
                        help='weights of h_infinity: "default", "thesis" or a file (YAML)')
    parser.add_argument("--scaling", choices=SCALINGS, default=SCALINGS[0],
                        help="D of the D-K iteration")
    parser.add_argument("--full-order", action="store_true", help="do not reduce the order")
    parser.add_argument("--at-once", action="store_true",
                        help="for a loop without averaging and computing time, as in the thesis")
    parser.add_argument("--delay-ticks", type=int, choices=(0, 1), default=1,
                        help="computing time: 1 where the controller answers the stage, 0 where "
                        "the stage evaluates the feedback by itself (default: %(default)s)")
    parser.add_argument("--disturbance-hz", type=float, default=DISTURBANCE_HZ,
                        help="bandwidth of the disturbances; with --feedback what is attenuated, "
                        "and repeats (default: %(default)g)")
    parser.add_argument("--rate", metavar="HZ", type=float, default=SAMPLE_RATE_HZ,
                        help="sample clock of the stage (default: %(default)g)")
    parser.add_argument("--samples-per-tick", type=int,
                        help="feedback period in samples; by the rules (5.10) by default")
    parser.add_argument("--output", type=Path, required=True,
                        help="controller file to write, or law file if the model is of several "
                        "axes; page and pictures are put next to it")
    add_report_option(parser, "CONTROLLER_report.html next to the controller")


def _check(options: argparse.Namespace) -> None:
    check_output_file(options.output)
    if not options.disturbance_hz > 0:
        raise ValueError(f"--disturbance-hz is {options.disturbance_hz:g}: give a positive number")
    if not 0.0 < options.rate < float("inf"):
        raise ValueError(f"--rate is {options.rate:g}: give a positive number")
    if options.samples_per_tick is not None and options.samples_per_tick < 1:
        raise ValueError(f"--samples-per-tick is {options.samples_per_tick}: give 1 or more")
    if not options.peak_sensitivity > 1:
        raise ValueError(f"--peak-sensitivity is {options.peak_sensitivity:g}: every loop has a "
                         "larger one; give a number above 1")
    usual = COMMAND.parser()
    given = [name for name in OF_A_TICK if getattr(options, name) != usual.get_default(name)]
    if options.feedback and given:
        raise ValueError(f"--{given[0].replace('_', '-')} is of the laws of a tick: leave it out "
                         "with --feedback")


COMMAND = Command(
    "design", "Design a feedback controller for a model, with a report and pictures.",
    _add_options, "piezo_controller.commands.design_work:design_controller",
    inputs=("model",), check=_check,
    interrupted="a controller file that it named as written is whole")
main = COMMAND.main
