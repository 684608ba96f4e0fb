# SPDX-License-Identifier: BSD-3-Clause
"""The work of `identify`: read the recordings, estimate the model, write and print it."""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from piezo_common.command_line import INTERRUPTED, budget_of, print_next, write_report
from piezo_common.progress_line import progress_printed
from piezo_identification.adequacy.component_adequacy import adequacy_table
from piezo_identification.commands.axes_work import are_of_axes, identify_axes_files
from piezo_identification.commands.identify_command import EXPERIMENTS
from piezo_identification.commands.response_options import (
    E_Y,
    READINGS,
    hold_s_of,
    refuse_response_options,
)
from piezo_identification.conditioning.segments import Recordings
from piezo_identification.estimators.frequency_response.response_file import (
    FrequencyResponse,
    is_frequency_response,
    read_frequency_response,
)
from piezo_identification.estimators.frequency_response.response_fit import ResponseOrder
from piezo_identification.identification.estimated_loops import DensityOptions
from piezo_identification.identification.given_data import given_data
from piezo_identification.identification.identify import identify
from piezo_identification.identification.notes import Detail, notes_printed
from piezo_identification.prediction.prediction_errors import named_errors
from piezo_identification.recording_check.suitability import misfits
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import check_model_may_replace, save_model
from piezo_models.model_summary import main_results
from piezo_recorder.reading.data_options import columns_given, read_given

PAGE_S = 5.0
"""Time (s) reserved to draw the page of a model."""


def identify_files(options: argparse.Namespace) -> int | None:
    """Identify a model from the given files; return the exit status if it was interrupted."""
    check_model_may_replace(options.output)
    density = DensityOptions(options.grid, options.smoothing, options.translation_weight)
    paths = {name: getattr(options, name) for name in EXPERIMENTS}
    by_name = {name: [given] if isinstance(given, Path) else given
               for name, given in paths.items() if given is not None}
    if are_of_axes(path for given in by_name.values() for path in given):
        return identify_axes_files(options, by_name)
    data = {name: _read(name, listed, options)
            for name, listed in paths.items() if listed is not None}
    for name, given in data.items():
        for misfit in misfits(given, name):
            if misfit.made_for and not options.anyway:
                raise ValueError(f"{misfit.sentence}; give it as --{misfit.made_for[0]}, which it "
                                 "can stand for, or go on with --anyway")
            print(misfit.sentence)
    _check_options(data.get("dynamics"), options)
    if options.band is not None:
        data["dynamics"] = data["dynamics"].between(*options.band)
    if isinstance(data.get("dynamics"), FrequencyResponse):
        data["dynamics"] = data["dynamics"].held(hold_s_of(options))
    budget = budget_of(options, PAGE_S if options.report else 0.0)
    with notes_printed(options.verbose) as notes, progress_printed(budget) as progress:
        identified = identify(
            **data, progress=progress, budget=budget, refine=options.refine, note=notes.append,
            method=options.method, read_at_samples=READINGS[options.rows_read],
            order=ResponseOrder(options.creep_pairs, options.modes, options.antiresonances),
            density=density)
    save_model(options.output, identified)
    _print_results(identified, options.verbose)
    print(f"model written to {options.output}")
    if identified.unfinished:
        print(f"the model is unfinished: {identified.unfinished}")
    if budget.is_interrupted:
        return INTERRUPTED
    if options.report:
        _write_report(identified, data, options,
                      [note for note in notes if isinstance(note, Detail)])
    print_next(options, "piezo_identification", "simulate", "--model", options.output, "--data",
               options.validation or "<a recording that was not fitted>", *columns_given(options),
               "--output", options.output.with_suffix(""))
    print_next(options, "piezo_controller", "design", "--model", options.output, "--output",
               options.output.with_name("controller.json"))
    return None


def _write_report(identified: IdentifiedModel, data: Mapping[str, Any],
                  options: argparse.Namespace, details: Sequence[Detail]) -> None:
    # Imported here, as drawing is slow to import and the page is optional.
    from piezo_identification.report.identification_report import identification_page

    given = given_data(data.get("creep"), data.get("dynamics"), data.get("hysteresis"),
                       data.get("validation"))
    write_report(options.output.with_name(f"{options.output.stem}_report.html"),
                 identification_page(identified, given, options.output,
                                     READINGS[options.rows_read], details))


def _read(name: str, paths: Path | Sequence[Path], options: argparse.Namespace) -> Any:
    """Read the files of an option; return one recording or response, or a list of recordings."""
    listed = [paths] if isinstance(paths, Path) else paths
    read: list[Any] = []
    for path in listed:
        print(f"reading {path}", flush=True)
        of_response = name == "dynamics" and is_frequency_response(path)
        read.append(read_frequency_response(path) if of_response else read_given(path, options))
        if of_response and len(listed) > 1:
            raise ValueError(f"{path} is a frequency response: give no other file to --dynamics")
    return read[0] if len(read) == 1 else read


def _check_options(
    dynamics: Recordings | FrequencyResponse | None, options: argparse.Namespace,
) -> None:
    """Raise ValueError for options that do not apply to the given data."""
    is_response = isinstance(dynamics, FrequencyResponse)
    useless = {
        "--modes": options.modes is not None and dynamics is None,
        "--antiresonances": options.antiresonances is not None and not is_response,
        "--band": options.band is not None and not is_response,
        **{option: value is not None and isinstance(dynamics, FrequencyResponse)
           and options.creep is None and options.hysteresis is None
           for option, value in (("--grid", options.grid), ("--smoothing", options.smoothing),
                                 ("--translation-weight", options.translation_weight))},
        "--creep-pairs": options.creep_pairs is not None and options.creep is None
        and not is_response,
    }
    if not is_response:
        refuse_response_options(options)
    for option in (option for option, is_useless in useless.items() if is_useless):
        raise ValueError(f"{option} has nothing to act on: leave it out, or give the data it is of")


def _print_results(identified: IdentifiedModel, verbose: bool) -> None:
    print(f"{identified.summary() if verbose else main_results(identified)}\n")
    print(adequacy_table(identified.adequacy))
    unseen = ", ".join(
        f"{what} {value:.3g} %" for what, value in named_errors(identified.errors))
    if unseen:
        print(f"e_y on data that was not fitted: {unseen}")
    print(E_Y)
