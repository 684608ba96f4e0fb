# SPDX-License-Identifier: BSD-3-Clause
"""Change the stage while a model watches it, and write the table into docs/diagnosis.md."""

import argparse
from pathlib import Path

from piezo_common.marked_sections import with_sections
from piezo_studies.changes_in_operation.watched import CHANGES, HOUR_S, table, watch
from piezo_studies.thesis.identified_stage import identified_stage

SECTION = "changes in operation"
"""Mark of the table in the page."""


def main(arguments: list[str] | None = None) -> None:
    """Run the command.

    Parameters
    ----------
    arguments : list of str, optional
        Those of the command line by default.
    """
    parser = argparse.ArgumentParser(prog="changes_in_operation", description=__doc__)
    parser.add_argument("--page", type=Path, default=Path("docs/diagnosis.md"),
                        help="page whose table is written anew; its text stays")
    options = parser.parse_args(arguments)
    model = identified_stage()
    runs = [watch(model, change, seed) for seed, change in enumerate(CHANGES, start=1)]
    runs.append(watch(model, "", 0, HOUR_S))
    text = options.page.read_text(encoding="utf-8")
    options.page.write_text(with_sections(text, {SECTION: table(runs)}), encoding="utf-8")
    print(table(runs))


if __name__ == "__main__":
    main()
