# SPDX-License-Identifier: BSD-3-Clause
"""`propose`: design the recording that decides between the alternatives of a diagnosis."""

import argparse
from pathlib import Path

from piezo_common.command_line import Command
from piezo_recorder.commands.data_flags import add_columns_option


def _add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--model", metavar="MODEL", type=Path, required=True,
                        help="model file that was diagnosed")
    parser.add_argument("--verdict", metavar="FILE", type=Path, required=True,
                        help="verdict.json of the diagnosis")
    parser.add_argument("--data", metavar="FILE", type=Path, required=True, nargs="+",
                        help="recordings or tables of samples that were diagnosed")
    parser.add_argument("--output", metavar="DIR", type=Path, required=True,
                        help="directory for waveform and expected outcome; made if it is missing")
    for name, unit, default, text in (
            ("longest-s", "S", 30.0, "time that the recording may last"),
            ("lowest-v", "V", -20.0, "lowest voltage that the stage allows"),
            ("highest-v", "V", 120.0, "highest voltage that the stage allows"),
            ("rest-v", "V", 0.0, "voltage of the stage at rest"),
            ("slew-limit-v-per-s", "NUMBER", 2e6, "fastest change of the voltage"),
            ("sample-rate-hz", "HZ", 40_000.0, "rate of the stage's sample clock")):
        parser.add_argument(f"--{name}", type=float, metavar=unit, default=default,
                            help=f"{text} (default: %(default)g)")
    add_columns_option(parser)


def _check(options: argparse.Namespace) -> None:
    for name in ("longest_s", "slew_limit_v_per_s", "sample_rate_hz"):
        if not 0.0 < getattr(options, name) < float("inf"):
            raise ValueError(f"--{name.replace('_', '-')} is {getattr(options, name):g}: give a "
                             "number above 0")
    if not options.lowest_v < options.highest_v:
        raise ValueError(f"--lowest-v is {options.lowest_v:g} and --highest-v "
                         f"{options.highest_v:g}: give the lower one as the lowest")


COMMAND = Command(
    "propose", "Design the recording that decides between explanations.", _add_options,
    "piezo_identification.commands.propose_work:propose_given",
    epilog="Writes next_experiment.csv, which `stage play` plays, and next_experiment.json with "
    "what each alternative predicts.",
    inputs=("model", "verdict", "data"), folders=("output",), check=_check)
main = COMMAND.main
