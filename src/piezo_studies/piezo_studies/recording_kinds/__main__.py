# SPDX-License-Identifier: BSD-3-Clause
"""Identify from every kind of recording, and print a table of what came out."""

import argparse
from dataclasses import asdict
from pathlib import Path

from piezo_studies.kept_results import KeptResults
from piezo_studies.recording_kinds.trials import STAGES, Outcome, run, trials

OUTCOMES = "outcomes.jsonl"
"""File of the completed trials in the folder, from which an interrupted table is resumed."""


def main(arguments: list[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="recording_kinds", description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("runs/recording-kinds"),
                        help="folder of recordings and models")
    parser.add_argument("--stage", nargs="+", choices=STAGES, default=tuple(STAGES))
    parser.add_argument("--only", default="", metavar="TEXT",
                        help="trials whose line in the table holds this text")
    parser.add_argument("--cpu-minutes", type=float, default=float("inf"), metavar="MINUTES",
                        help="end before the first trial after so much time of the processor")
    options = parser.parse_args(arguments)
    options.output.mkdir(parents=True, exist_ok=True)
    print("| stage and recordings | error on unseen data | verdict | CPU |\n|---|---|---|---|")
    file, used_s = KeptResults(options.output / OUTCOMES), 0.0
    kept = {text: Outcome(**outcome) for text, outcome in file.results().items()}
    for trial in trials(tuple(options.stage)):
        text = str(trial)
        if options.only not in text or used_s > 60.0 * options.cpu_minutes:
            continue
        if text not in kept:
            kept[text] = run(trial, options.output)
            used_s += kept[text].cpu_s
            file.add(text, asdict(kept[text]))
        outcome = kept[text]
        print(f"| {text} | {outcome.error_percent:.3g} % | {outcome.verdict} | "
              f"{outcome.cpu_s:.0f} s |", flush=True)


if __name__ == "__main__":
    main()
