# SPDX-License-Identifier: BSD-3-Clause
"""The work of `check`: print and draw the properties of each recording."""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from piezo_common.budget import Budget
from piezo_common.command_line import budget_of, print_next, write_report
from piezo_common.picture_style import to_png
from piezo_identification.analysis.distortion_over_frequency import distortion_png, distortion_rows
from piezo_identification.axes.axes_response import is_axes_response
from piezo_identification.commands.axes_work import check_axes_file
from piezo_identification.estimators.frequency_response.response_file import (
    is_frequency_response,
    read_frequency_response,
)
from piezo_identification.recording_check.check import RecordingCheck, check_recording
from piezo_identification.recording_check.check_report import check_table
from piezo_identification.recording_check.suitability import Suitability, given_as, suitability
from piezo_identification.report.check_page import check_figure, check_page
from piezo_recorder.reading.axes import is_of_axes
from piezo_recorder.reading.data_options import columns_given, read_all_given
from piezo_recorder.reading.recording import Recording

DOTS_PER_INCH = 110.0
DRAWN_UNTIL = 0.5
"""Fraction of the time budget after which nothing more is drawn."""


def check_files(options: argparse.Namespace) -> None:
    """Print and draw the properties of each recording given as an option."""
    options.output.mkdir(parents=True, exist_ok=True)
    budget = budget_of(options)
    checked: list[tuple[str, RecordingCheck, dict[str, Suitability], Figure | None]] = []
    fit_for: dict[str, dict[str, Suitability]] = {}
    responses: list[str] = []
    of_axes: list[str] = []
    for path in options.data:
        if checked and budget.is_spent():
            budget.not_tried.append(f"{path}")
            continue
        if is_of_axes(path) or is_axes_response(path):
            check_axes_file(path)
            (responses if is_axes_response(path) else of_axes).append(str(path))
            continue
        if is_frequency_response(path):
            _print_response(path)
            responses.append(str(path))
            continue
        recordings = read_all_given(path, options)
        for number, recording in enumerate(recordings, start=1):
            several = len(recordings) > 1
            print(f"{path}" + (f", recording {recording.title}" if several else ""))
            stem = f"{path.stem}{f'_{number}' if several else ''}"
            checked.append((stem, *_check_one(
                recording, options.output / f"{stem}_check.png", budget)))
            if not several:
                fit_for[str(path)] = checked[-1][2]
    drawn = [(stem, check, of_check, figure) for stem, check, of_check, figure in checked if figure]
    if drawn and options.report and not budget.is_spent(DRAWN_UNTIL):
        write_report(options.output / "check_report.html", check_page(drawn))
    elif checked and options.report:
        budget.not_tried.append("the page")
    if budget.not_tried:
        print(budget.sentence("done"))
    given = given_as(fit_for)
    # A frequency response cannot be combined with other files for the dynamics.
    given |= {"dynamics": responses[:1] or of_axes} if responses or of_axes else {}
    named = [word for experiment, paths in given.items() for word in (f"--{experiment}", *paths)]
    print_next(options, "piezo_identification", "identify",
               *(named or ("<--creep, --dynamics or --hysteresis>", options.data[0])),
               *columns_given(options), "--output", "model.json")


def _check_one(recording: Recording, picture: Path, budget: Budget,
               ) -> tuple[RecordingCheck, dict[str, Suitability], Figure | None]:
    check = check_recording(recording)
    fit_for = suitability(check)
    print("\n".join(check_table(check, fit_for)))
    if budget.is_spent(DRAWN_UNTIL):
        budget.not_tried.append(f"{picture}")
        return check, fit_for, None
    figure = check_figure(check)
    picture.write_bytes(to_png(figure, DOTS_PER_INCH))
    print(f"drawn {picture}")
    if (found := check.distortion) is not None:
        drawn = picture.with_name(picture.name.removesuffix("_check.png") + "_distortion.png")
        print("\n".join("".join(f"{cell:>24}" for cell in row) for row in distortion_rows(found)))
        drawn.write_bytes(distortion_png(found))
        print(f"drawn {drawn}")
    return check, fit_for, figure


def _print_response(path: Path) -> None:
    response = read_frequency_response(path)
    gain = np.abs(response.gain)
    peak = int(np.argmax(gain))
    print(f"{path}: a frequency response of {gain.size} points, "
          f"{response.frequency_hz[0]:.5g} to {response.frequency_hz[-1]:.5g} Hz, largest gain "
          f"{gain[peak]:.4g} at {response.frequency_hz[peak]:.5g} Hz; it can stand for the "
          "dynamics")
