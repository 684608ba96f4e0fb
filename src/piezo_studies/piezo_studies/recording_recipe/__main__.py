# SPDX-License-Identifier: BSD-3-Clause
"""Run the trials of recordings, and write their tables into docs/recipe.md."""

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path

from piezo_studies.marked_sections import with_sections
from piezo_studies.recording_recipe.recipe_trials import TABLES, Trial

SECTIONS = "trials of "
"""Beginning of the marks of the tables in the page."""


def main(arguments: list[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="recording_recipe", description=__doc__)
    parser.add_argument("--page", type=Path, default=Path("docs/recipe.md"),
                        help="page whose tables are written again; its text stays")
    options = parser.parse_args(arguments)
    made: dict[str, list[Trial]] = {}
    for name, (_, _, trials) in TABLES.items():
        made[name] = []
        for trial in trials():
            made[name].append(trial)
            print(f"{name}: {trial.asked}: {trial.error_percent:.2g} %", file=sys.stderr,
                  flush=True)
    options.page.write_text(page(options.page.read_text(encoding="utf-8"), made),
                            encoding="utf-8")
    print(f"{sum(len(each) for each in made.values())} trials: {options.page}")


def page(text: str, made: dict[str, list[Trial]]) -> str:
    """Return the text of the page with its tables replaced.

    Raises
    ------
    ValueError
        If the page lacks the section of a table, or has an additional one.
    """
    tables = {SECTIONS + name: table(name, trials) for name, trials in made.items()}
    return with_sections(text, tables, SECTIONS)


def table(name: str, trials: Iterable[Trial]) -> str:
    """Return the rows of a table as Markdown."""
    varied, predicted, _ = TABLES[name]
    rows = [f"| {varied} | recorded for | samples | error on {predicted} |", "|---|---|---|---|",
            *(f"| {trial.asked} | {trial.recorded_s:.3g} s | {trial.samples} | "
              f"{trial.error_percent:.2g} % |" for trial in trials)]
    return "\n".join(rows) + "\n"


if __name__ == "__main__":
    main()
