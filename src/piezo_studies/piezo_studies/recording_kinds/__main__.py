# SPDX-License-Identifier: BSD-3-Clause
"""Identify from every kind of recording, and print a table of what came out."""

import argparse
from pathlib import Path

from piezo_studies.recording_kinds.trials import STAGES, run, trials


def main(arguments: list[str] | None = None) -> None:
    """Run the command.

    Parameters
    ----------
    arguments : list of str, optional
        Those of the command line by default.
    """
    parser = argparse.ArgumentParser(prog="recording_kinds", description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("runs/recording-kinds"),
                        help="folder of recordings and models")
    parser.add_argument("--stage", nargs="+", choices=STAGES, default=tuple(STAGES))
    parser.add_argument("--only", default="", metavar="TEXT",
                        help="trials whose line in the table holds this text")
    options = parser.parse_args(arguments)
    options.output.mkdir(parents=True, exist_ok=True)
    print("| stage and recordings | error on unseen data | verdict | CPU |\n|---|---|---|---|")
    for trial in trials(tuple(options.stage)):
        if options.only in str(trial):
            outcome = run(trial, options.output)
            print(f"| {trial} | {outcome.error_percent:.3g} % | {outcome.verdict} | "
                  f"{outcome.cpu_s:.0f} s |", flush=True)


if __name__ == "__main__":
    main()
