# SPDX-License-Identifier: BSD-3-Clause
"""The work of `simulate`: compare the model with a recording."""

import argparse
from pathlib import Path

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_common.command_line import print_next, write_report
from piezo_common.picture_style import to_png
from piezo_identification.commands.axes_work import simulate_axes_file
from piezo_identification.commands.response_options import E_Y, READINGS
from piezo_identification.prediction import Prediction
from piezo_identification.prediction.outside_identified import outside_identified
from piezo_identification.prediction.row_reading import predict_as_identified
from piezo_identification.report.simulation_report import (
    displacement_figure,
    loops_figure,
    simulation_page,
)
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import announced_model, is_of_several_axes
from piezo_recorder.reading.data_options import columns_given, read_given
from piezo_recorder.reading.waveform_file import read_waveform

DOTS_PER_INCH = 120


def simulate_file(options: argparse.Namespace) -> None:
    """Simulate the model for the voltage of a recording, print the error, and draw both."""
    if is_of_several_axes(options.model):
        simulate_axes_file(options)
        return
    model_path, data_path, directory = options.model, options.data, options.output
    identified = announced_model(model_path)
    if options.voltage:
        _predict(identified, options.voltage, directory)
        print_next(options, "piezo_identification", "simulate", "--model", model_path, "--data",
                   f"<a recording of {options.voltage}>", "--output", directory)
        return
    prediction, sentences = predict_as_identified(
        identified, read_given(data_path, options), READINGS[options.rows_read])
    for sentence in sentences:
        print(sentence)
    print(f"e_y_percent {prediction.e_y_percent():.4g}")
    found = outside_identified(identified, prediction.voltage_v, prediction.past_v)
    for sentence in found.sentences():
        print(sentence)
    inside = ~found.outside & prediction.good
    if found.outside.any() and np.unique(prediction.measured_um[inside]).size > 1:
        print(f"e_y_percent_inside {prediction.e_y_percent(inside):.4g}")
    if directory is not None:
        _draw(directory, prediction, found.deviation_um)
        if options.report:
            write_report(directory / "simulation_report.html", simulation_page(
                prediction, [f"model: `{model_path}`", f"recording: `{data_path}`"],
                [f"{sentence}." for sentence in (*sentences, *found.sentences())],
                found.deviation_um))
    print(E_Y)
    print_next(options, "piezo_identification", "diagnose", "--model", model_path, "--data",
               data_path, *columns_given(options), "--output", (directory or Path()) / "diagnosis")


def _predict(identified: IdentifiedModel, path: Path, directory: Path) -> None:
    """Write the simulated displacement for a voltage without a measurement."""
    voltage_v, period_s, axes, _ = read_waveform(path)
    if axes:
        raise ValueError(f"{path} has the axes {', '.join(axes)}, the model one: give the voltage "
                         "of one axis")
    displacement_um = identified.predict(voltage_v, period_s)
    directory.mkdir(parents=True, exist_ok=True)
    written = directory / "predicted.csv"
    np.savetxt(written, np.column_stack(
        [period_s * np.arange(voltage_v.size), voltage_v, displacement_um]), "%.9g", ",",
        header="time_s,voltage_v,displacement_um", comments="")
    print(f"displacement {displacement_um.min():.6g} to {displacement_um.max():.6g} um")
    for sentence in outside_identified(identified, voltage_v, ()).sentences():
        print(sentence)
    print(f"written {written}")


def _draw(directory: Path, prediction: Prediction, deviation_um: FloatArray) -> None:
    directory.mkdir(parents=True, exist_ok=True)
    figures = {"displacement.png": displacement_figure(prediction, deviation_um),
               "loops.png": loops_figure(prediction)}
    for name, figure in figures.items():
        (directory / name).write_bytes(to_png(figure, DOTS_PER_INCH))
        print(f"drawn {directory / name}")
