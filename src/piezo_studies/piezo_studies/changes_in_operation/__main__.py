# SPDX-License-Identifier: BSD-3-Clause
"""Change the stage while a model watches it, and write the table into docs/diagnosis.md."""

import argparse
import re
from pathlib import Path

from piezo_studies.changes_in_operation.watched import CHANGES, HOUR_S, table, watch
from piezo_studies.thesis.identified_stage import identified_stage

SECTION = re.compile(r"(<!-- changes in operation -->\n).*?(<!-- end -->)", re.S)


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
    made = SECTION.sub(lambda match: match[1] + table(runs) + match[2], text)
    options.page.write_text(made, encoding="utf-8")
    print(table(runs))


if __name__ == "__main__":
    main()
