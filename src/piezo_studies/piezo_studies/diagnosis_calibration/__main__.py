# SPDX-License-Identifier: BSD-3-Clause
"""Diagnose drawn cases by the hundred, and write how often what is stated is true."""

import argparse
from pathlib import Path

import numpy as np

from piezo_common.progress_line import ProgressLine
from piezo_studies.diagnosis_calibration.model_errors import errors_over_stated, sentence
from piezo_studies.diagnosis_calibration.page import write_page
from piezo_studies.diagnosis_calibration.small_cases import PLANTS
from piezo_studies.diagnosis_calibration.study import figures, model_of, run_study


def main(arguments: list[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="diagnosis_calibration", description=__doc__)
    parser.add_argument("--cases", type=int, default=100, help="how many (%(default)s)")
    parser.add_argument("--seed", type=int, default=523, help="of everything random (%(default)s)")
    parser.add_argument("--seconds", type=float, default=float("inf"),
                        help="of the processor, after which no other case begins")
    parser.add_argument("--output", type=Path, default=Path("runs/diagnosis-calibration"),
                        help="directory of models and results, from which a run goes on")
    parser.add_argument("--page", type=Path,
                        help="page whose section is written again, such as "
                             "docs/studies/diagnosis_rates.md; its picture goes to pictures "
                             "next to it")
    parser.add_argument("--model-errors", action="store_true",
                        help="report only the errors of the models in clean recordings")
    options = parser.parse_args(arguments)
    if options.model_errors:
        print(sentence(np.concatenate([
            errors_over_stated(options.seed, plant, model_of(options.output, options.seed, plant))
            for plant in range(PLANTS)])))
        return
    line = ProgressLine()
    results = run_study(options.seed, options.cases, options.output, options.seconds,
                        lambda done: line.show("cases", done / options.cases))
    line.clear()
    reliability, intervals = figures(results)
    print(f"{len(results)} cases of seed {options.seed}: {reliability.sentence()}; "
          f"{intervals['right']} of {intervals['intervals']} intervals of 90 % contain the "
          "parameter")
    if options.page is not None:
        write_page(options.page, options.seed, results)


if __name__ == "__main__":
    main()
