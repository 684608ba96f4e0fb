# SPDX-License-Identifier: BSD-3-Clause
"""The work of `identify`, `simulate`, `diagnose` and `check` for files of several axes."""

import argparse
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from piezo_common.command_line import INTERRUPTED, budget_of, print_next
from piezo_common.picture_style import to_png
from piezo_common.progress_line import progress_printed
from piezo_common.summary_table import SummaryTable
from piezo_identification.axes.axes_response import (
    AxesResponse,
    is_axes_response,
    read_axes_response,
)
from piezo_identification.axes.diagnose_axes import diagnose_axes
from piezo_identification.axes.identify_axes import identify_several_axes
from piezo_identification.axes.predict_axes import predict_several_axes
from piezo_identification.axes.spectra import levels_of
from piezo_identification.commands.response_options import (
    E_Y,
    HELD,
    hold_s_of,
    rate_hz_of,
    refuse_response_options,
)
from piezo_identification.identification.notes import notes_printed
from piezo_models.axes_model_file import load_axes_model, save_axes_model
from piezo_recorder.reading.axes import AxesRecording, is_of_axes, read_axes

OF_ONE_AXIS = ("creep_pairs", "antiresonances", "band", "grid", "smoothing", "translation_weight")
"""Options of `identify` that apply only to models of one axis."""


def are_of_axes(paths: Iterable[Path]) -> bool:
    """Return whether files are recordings or responses of several axes.

    Raise ValueError if some files are of one axis and others of several.
    """
    listed = list(paths)
    of_axes = [is_of_axes(path) or is_axes_response(path) for path in listed]
    if any(of_axes) and not all(of_axes):
        raise ValueError(f"{listed[of_axes.index(False)]} is of one axis and "
                         f"{listed[of_axes.index(True)]} of several: give files of one stage")
    return bool(listed) and all(of_axes)


def identify_axes_files(options: argparse.Namespace,
                        paths: Mapping[str, Sequence[Path]]) -> int | None:
    """Identify a model of several axes, write it, and print a summary.

    The files are listed by experiment; see `identify_several_axes`. Return the exit status if the
    work was interrupted.
    """
    for name in OF_ONE_AXIS:
        if getattr(options, name) is not None:
            raise ValueError(f"--{name.replace('_', '-')} is for one axis: leave it out")
    dynamics = _dynamics(options, paths.get("dynamics", ()))
    others = {name: _read(paths.get(name, ())) for name in ("validation", "creep", "hysteresis")}
    budget = budget_of(options)
    with notes_printed(options.verbose) as notes, progress_printed(budget) as progress:
        identified = identify_several_axes(
            dynamics, **others, pairs=options.modes, note=notes.append, progress=progress,
            budget=budget)
    save_axes_model(options.output, identified)
    print(identified.summary())
    print(E_Y)
    print(f"model written to {options.output}")
    if budget.is_interrupted:
        return INTERRUPTED
    print_next(options, "piezo_identification", "simulate", "--model", options.output, "--data",
               options.validation or "<a recording that was not fitted>", "--output",
               options.output.with_suffix(""))
    return None


def _dynamics(options: argparse.Namespace, paths: Sequence[Path],
              option: str = "--dynamics") -> list[AxesRecording] | AxesResponse:
    """Read the recordings that an option names, or the frequency response."""
    response = next(filter(is_axes_response, paths), None)
    if response is None:
        refuse_response_options(options)
        return _read(paths)
    if len(paths) > 1:
        raise ValueError(f"{response} is a frequency response: give no other file to {option}")
    print(f"reading {response}", flush=True)
    return read_axes_response(response, rate_hz_of(options), options.response == HELD)


def simulate_axes_file(options: argparse.Namespace) -> None:
    """Simulate a model of several axes for recordings, print the errors, and draw both."""
    if options.voltage:
        raise ValueError("--voltage is for a model of one axis: give --data, or use "
                         "CoupledModel.simulate in Python")
    model = load_axes_model(options.model).model
    for recording in _read([options.data]):
        prediction = predict_several_axes(model, recording)
        print(recording.name)
        for axis, error in prediction.e_y_percent().items():
            print(f"{axis} e_y_percent {error:.4g}")
        if options.output is not None:
            options.output.mkdir(parents=True, exist_ok=True)
            name = "_".join(filter(None, ("displacement", recording.title)))
            picture = options.output / f"{name}.png"
            picture.write_bytes(to_png(prediction.plot()))
            print(f"drawn {picture}")
    print(E_Y)


def diagnose_axes_file(options: argparse.Namespace) -> None:
    """Diagnose a recording or response of several axes, and write and print the results."""
    for name in ("holdout", "identified_from"):
        if getattr(options, name):
            raise ValueError(f"--{name.replace('_', '-')} is for a model of one axis: leave it out")
    identified = load_axes_model(options.model)
    data: Sequence[AxesRecording] | Sequence[AxesResponse] | AxesResponse = _dynamics(
        options, options.data, "--data")
    if isinstance(data, AxesResponse):
        hold_s_of(options)  # refuses a rate that a continuous response does not have
        data = [data]
    if len(data) != 1:
        raise ValueError(f"--data holds {len(data)} recordings: give one recording for a "
                         "model of several axes")
    diagnosis = diagnose_axes(identified, data[0])
    diagnosis.write(options.output)
    print(diagnosis)
    print(f"written to {options.output}")


def check_axes_file(path: Path) -> None:
    """Print a table of the recordings or the response in a file of several axes."""
    if is_axes_response(path):
        print(response_table(read_axes_response(path)))
    else:
        print(axes_table(str(path), _read([path])))


def response_table(response: AxesResponse) -> SummaryTable:
    """Return a table of the gain and its deviation in each entry of a response."""
    size, deviation = np.abs(response.gain_um_per_v), response.deviation_um_per_v
    highest = np.argmax(size, axis=0)
    rows: list[tuple[str | float | None, ...]] = [
        (f"{moved} from {driven}", float(size[0, i, j]), float(size[highest[i, j], i, j]),
         float(response.frequency_hz[highest[i, j]]),
         None if deviation is None else float(np.median(deviation[:, i, j])))
        for i, moved in enumerate(response.axes) for j, driven in enumerate(response.axes)]
    notes = (f"a frequency response of {response.frequency_hz.size} points, "
             f"{response.frequency_hz[0]:.5g} to {response.frequency_hz[-1]:.5g} Hz; it can stand "
             "for the dynamics",)
    return SummaryTable(response.name, (
        "entry", "first gain (um/V)", "largest gain (um/V)", "at (Hz)", "std. dev. (um/V)"),
        rows, notes)


def axes_table(name: str, recordings: Sequence[AxesRecording]) -> SummaryTable:
    """Return a table of the motion and the noise of each axis in each recording, with notes."""
    rows: list[tuple[str | float | None, ...]] = []
    for recording in recordings:
        moves = np.ptp(recording.voltage_v, axis=0) > 0.0
        noise = _noise_um(recording)
        rows += [(recording.title, axis, "yes" if moves[number] else "no",
                  float(np.std(recording.voltage_v[:, number])),
                  float(np.std(recording.displacement_um[:, number])),
                  None if noise is None else float(noise[number]))
                 for number, axis in enumerate(recording.axes)]
    first = recordings[0]
    levels = levels_of(recordings)
    notes = [f"{len(recordings)} recordings of {len(first.voltage_v)} samples at "
             f"{1.0 / first.sample_period_s:.6g} Hz, {first.periods or 'no'} periods known to be "
             "equal, at the levels (RMS) " + ", ".join(
                 f"{level[0].amplitude_v:.3g} V of {len(level)}" for level in levels)]
    enough = all(level[0].periods and len(level) > len(first.axes) for level in levels)
    notes.append(
        "more realisations than axes at each level: noise and distortion are separated from the "
        "response, and softening is estimated from several levels" if enough else
        "noise and distortion are estimated from the residual of a model; more realisations of "
        "equal periods than axes would separate them")
    resting = [axis for number, axis in enumerate(first.axes)
               if all(np.ptp(each.voltage_v[:, number]) == 0.0 for each in recordings)]
    if resting:
        notes.append(f"at rest throughout: {', '.join(resting)}; record how they move, too")
    return SummaryTable(name, ("recording", "axis", "moves", "voltage RMS (V)",
                               "displacement RMS (um)", "noise RMS (um)"), rows, tuple(notes))


def _noise_um(recording: AxesRecording) -> np.ndarray | None:
    """Return the noise from the differences of equal periods, shape (n,); None without periods."""
    if recording.periods < 2:
        return None
    periods = recording.displacement_um.reshape(recording.periods, -1, len(recording.axes))
    noise: np.ndarray = np.sqrt(np.mean(np.var(periods, axis=0, ddof=1), axis=0))
    return noise


def _read(paths: Iterable[Path]) -> list[AxesRecording]:
    recordings = []
    for path in paths:
        print(f"reading {path}", flush=True)
        recordings += read_axes(path)
    for note in dict.fromkeys(note for each in recordings for note in each.notes):
        print(note)
    return recordings
