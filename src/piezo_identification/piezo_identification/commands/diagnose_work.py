# SPDX-License-Identifier: BSD-3-Clause
"""The work of `diagnose`: find what the model lacks, write and print it."""

import argparse
import sys

from piezo_common.budget import Budget
from piezo_common.command_line import INTERRUPTED, budget_of, print_next
from piezo_common.progress_line import progress_printed
from piezo_identification.commands.axes_work import diagnose_axes_file
from piezo_identification.commands.response_options import hold_s_of, refuse_response_options
from piezo_identification.diagnosis.evidence.effect_entries import name_of
from piezo_identification.diagnosis.joint.probabilities import LISTED
from piezo_identification.diagnosis.report.diagnosis_report import verdict_sentence
from piezo_identification.diagnosis.report.diagnosis_results import diagnose_files
from piezo_identification.diagnosis.response.response_results import (
    diagnose_response_file,
    response_sentence,
)
from piezo_identification.diagnosis.verdict import Verdict
from piezo_identification.estimators.frequency_response.response_file import is_frequency_response
from piezo_models.model_file import announced_model, is_of_several_axes
from piezo_recorder.reading.data_options import read_all_given

PAGE_S, RESPONSE_PAGE_S = 5.0, 1.0
"""Time (s) reserved to draw and write the results of recordings and of a response."""


def diagnose_given(options: argparse.Namespace) -> int | None:
    """Diagnose the given recordings; return the exit status if the comparison was interrupted."""
    if is_of_several_axes(options.model):
        diagnose_axes_file(options)
        return None
    is_response = is_frequency_response(options.data[0])
    if not is_response:
        refuse_response_options(options)
    elif len(options.data) > 1 or options.holdout or options.identified_from:
        raise ValueError(f"{options.data[0]} is a frequency response: give it alone")
    announced_model(options.model)
    budget = budget_of(options, RESPONSE_PAGE_S if is_response else PAGE_S)
    diagnosis = (_diagnose_response if is_response else _diagnose_recordings)(options, budget)
    print(f"written to {options.output}")
    print(f"report: {options.output / 'report.html'}")
    if diagnosis.not_tried:
        print(f"{options.prog}: {diagnosis.not_tried}; the results hold what was found until then",
              file=sys.stderr)
    if budget.is_interrupted:
        return INTERRUPTED
    if not is_response:
        print_next(options, "piezo_controller", "design", "--model",
                   options.output / "extended_model.json", "--output",
                   options.output / "controller.json")
    return None


def _diagnose_response(options: argparse.Namespace, budget: Budget) -> Verdict:
    with progress_printed(budget) as progress:
        diagnosis = diagnose_response_file(
            options.model, options.data[0], options.output, hold_s_of(options), progress, budget)
    _print_table(diagnosis, response_sentence(diagnosis))
    return diagnosis


def _diagnose_recordings(options: argparse.Namespace, budget: Budget) -> Verdict:
    with progress_printed(budget) as progress:
        results = diagnose_files(
            options.model, options.data, options.holdout, options.output, progress,
            lambda path: read_all_given(path, options),
            identified_from=options.identified_from, budget=budget)
    _print_table(results.diagnosis, verdict_sentence(results.diagnosis))
    for sentence in filter(None, [results.identified_from.not_asked, *results.outside]):
        print(sentence)
    if results.next_experiment is not None:
        print(f"what would decide: {results.next_experiment.sentence()}")
    return results.diagnosis


def _print_table(diagnosis: Verdict, sentence: str) -> None:
    for fault in diagnosis.recording_faults:
        print(f"{fault['sentence']}; {fault['remedy']}")
    for text in diagnosis.left_out:
        print(text)
    print(f"verdict: {diagnosis.verdict}. {sentence}")
    shares = [f"{name} {share:.3f}" for name, share in diagnosis.probabilities.items()
              if share >= LISTED]
    if shares:
        print(f"probability: {', '.join(shares)}")
    print(f"{'':28}{'before':>12}{'after':>12}")
    for name in ("rms_um", "e_y_percent"):
        print(f"{name:28}{diagnosis.before[name]:12.4g}{diagnosis.after[name]:12.4g}")
    print(f"{'noise_floor_um':28}{diagnosis.noise_floor_um:12.4g}")
    for entry in diagnosis.effects:
        print(f"{name_of(entry):28}{entry['error_reduction_percent']:11.1f} % of the error")
        for name, value in entry["parameters"].items():
            numbers = value if isinstance(value, (list, tuple)) else [value]
            print(f"  {name:26}{', '.join(f'{number:.5g}' for number in numbers):>12}")
    for name, reason in diagnosis.not_decidable.items():
        print(f"not decidable: {name}: {reason}")
    if diagnosis.left:
        print(diagnosis.left)
