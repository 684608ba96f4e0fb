# SPDX-License-Identifier: BSD-3-Clause
"""`diagnose`: find the effects that a model lacks to explain a recording."""

import argparse
from pathlib import Path

from piezo_common.command_line import Command, add_budget_option
from piezo_identification.commands.response_options import add_response_options
from piezo_recorder.commands.data_flags import add_columns_option


def _add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--model", metavar="MODEL", type=Path, required=True, help="model file")
    parser.add_argument("--data", metavar="FILE", type=Path, required=True, nargs="+",
                        help="recordings or tables of samples (CSV, .mat, .h5, .npz, .tdms, "
                        ".parquet and others), or one measured frequency response "
                        "(frequency_hz,gain_re,gain_im)")
    parser.add_argument("--holdout", metavar="FILE", type=Path,
                        help="another recording, on which the errors are measured")
    parser.add_argument("--identified-from", metavar="FILE", type=Path, nargs="+", default=[],
                        help="the recordings that the model was identified from, where they are "
                        "not at the paths that the model file names")
    parser.add_argument("--output", metavar="DIR", type=Path, required=True,
                        help="directory for the results; made if it is missing")
    add_budget_option(parser)
    add_columns_option(parser)
    add_response_options(parser)


COMMAND = Command(
    "diagnose", "Find the effect that a model lacks to explain recordings.", _add_options,
    "piezo_identification.commands.diagnose_work:diagnose_given",
    epilog="Writes verdict.json, extended_model.json and report.html. Effects are fitted on "
    "two thirds of the recordings and compared on the rest, the validation set.",
    inputs=("model", "data", "holdout", "identified_from"), folders=("output",),
    interrupted="nothing is known yet; results in --output, if any, are of an earlier run")
main = COMMAND.main
