# SPDX-License-Identifier: BSD-3-Clause
"""Follow a published reference with several previews, and write their errors into a page."""

import argparse
from pathlib import Path

from piezo_studies.marked_sections import write_sections
from piezo_studies.published_reference.by_preview import compare, table
from piezo_studies.thesis.identified_stage import identified_stage

SECTION = "published references"
"""Mark of the table in the page."""


def main(arguments: list[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="published_reference", description=__doc__)
    parser.add_argument("--page", type=Path, default=Path("docs/published_reference.md"),
                        help="page whose table is written again; its text stays")
    options = parser.parse_args(arguments)
    rows = compare(identified_stage())
    write_sections(options.page, {SECTION: table(rows)})
    print(f"{len(rows)} runs: {options.page}")


if __name__ == "__main__":
    main()
