# SPDX-License-Identifier: BSD-3-Clause
"""`simulate`: what a model says beside what a recording measured."""

import argparse
import sys
from pathlib import Path

import numpy as np

from piezo_common.command_line import run_command
from piezo_identification.commands.row_options import READINGS, add_rows_option
from piezo_identification.conditioning.outlier_samples import outlier_text
from piezo_identification.conditioning.row_alignment import rows_read_at_start
from piezo_identification.conditioning.sensor_sign import sign_text
from piezo_identification.prediction import predict
from piezo_identification.prediction.outside_identified import outside_identified
from piezo_identification.prediction.prediction_pictures import draw_displacement, draw_loops
from piezo_models.model_file import load_model
from piezo_recorder.reading.data_options import FILE_HELP, add_columns_option, read_given


def main(arguments: list[str] | None = None) -> int:
    """Run the command.

    Parameters
    ----------
    arguments : list of str, optional
        The command line's by default.

    Returns
    -------
    int
        Exit status: 0, or 2 for input that cannot be used.
    """
    parser = argparse.ArgumentParser(
        prog="simulate", description="Simulate a model under the voltage of a recording.",
        epilog="e_y (4.20) is the relative error by the sensor; offset, initial creep and the "
        "past of the hysteresis, as far as the recording does not tell them, are fitted.",
    )
    parser.add_argument("--model", metavar="MODEL", type=Path, required=True, help="model file")
    parser.add_argument("--data", metavar="FILE", type=Path, required=True,
                        help=FILE_HELP)
    parser.add_argument("--output", metavar="DIR", type=Path,
                        help="directory for the pictures; none are drawn without it")
    add_columns_option(parser)
    add_rows_option(parser)
    return run_command(parser, _simulate, arguments)


def _simulate(options: argparse.Namespace) -> None:
    model_path, data_path, directory = options.model, options.data, options.output
    identified = load_model(model_path)
    recording = rows_read_at_start(read_given(data_path, options), READINGS[options.rows_read])
    prediction = predict(identified.model, recording)
    if prediction.reversed:
        print(sign_text(data_path))
    if not prediction.good.all():
        print(outlier_text(data_path, ~prediction.good, prediction.time_s))
    if prediction.past_v:
        print("the recording does not begin saturated: taken to have come from {:.4g} V by way of "
              "{:.4g} V".format(*prediction.past_v))
    print(f"e_y_percent {prediction.e_y_percent():.4g}")
    found = outside_identified(identified, prediction.voltage_v, prediction.past_v)
    for sentence in found.sentences():
        print(sentence)
    inside = ~found.outside & prediction.good
    if found.outside.any() and np.unique(prediction.measured_um[inside]).size > 1:
        print(f"e_y_percent_inside {prediction.e_y_percent(inside):.4g}")
    if directory is None:
        return
    directory.mkdir(parents=True, exist_ok=True)
    draw_displacement(directory / "displacement.png", prediction, found.deviation_um)
    draw_loops(directory / "loops.png", prediction)
    for name in ("displacement.png", "loops.png"):
        print(f"drawn {directory / name}")


if __name__ == "__main__":
    sys.exit(main())
