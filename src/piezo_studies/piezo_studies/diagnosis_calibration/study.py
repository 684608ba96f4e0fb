# SPDX-License-Identifier: BSD-3-Clause
"""Runs of the study; every result is saved at once, so that a run can be resumed."""

import time

from piezo_models.model_file import load_model, save_model
from piezo_studies.diagnosis_benchmark.calibration import calibrate
from piezo_studies.diagnosis_benchmark.coverage import coverage
from piezo_studies.diagnosis_benchmark.run_case import clean_model
from piezo_studies.diagnosis_calibration.small_cases import PLANTS, draw_case
from piezo_studies.diagnosis_calibration.small_runs import run_small_case
from piezo_studies.kept_results import KeptResults


def run_study(seed, count, directory, seconds, report):
    """Run cases until all are done or the time is over.

    Parameters
    ----------
    seconds : float
        Processor time after which no further case is started.
    """
    directory.mkdir(parents=True, exist_ok=True)
    file, models = KeptResults(directory / f"cases_{seed}.jsonl"), {}
    kept, begun = file.results(), time.process_time()
    for number in range(count):
        if number in kept:
            continue
        if time.process_time() - begun > seconds:
            break
        plant = number % PLANTS
        if plant not in models:
            models[plant] = model_of(directory, seed, plant)
        kept[number] = run_small_case(draw_case(number, seed), models[plant])
        file.add(number, kept[number])
        report(len(kept))
    return [kept[number] for number in range(count) if kept.get(number) is not None]


def figures(results):
    """Return the calibration and the coverage of results.

    Returns
    -------
    Reliability
    dict
        Result of `coverage`.
    """
    return calibrate(results), coverage(results)


def model_of(directory, seed, plant):
    """Return the model of a plant without effects; it is identified once and saved."""
    directory.mkdir(parents=True, exist_ok=True)
    path = directory / f"model_{seed}_{plant}.json"
    if not path.exists():
        identified, _ = clean_model(seed, plant)
        save_model(path, identified)
    return load_model(path)
