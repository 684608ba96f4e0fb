# SPDX-License-Identifier: BSD-3-Clause
"""Run all studies: print the table, and write it as JSON and, with pictures, into a page."""

import argparse
import sys
import time
from pathlib import Path

from piezo_studies.marked_sections import write_sections
from piezo_studies.thesis.figure_table import as_json, as_markdown, as_text
from piezo_studies.thesis.pictures import small_png
from piezo_studies.thesis.studies import STUDIES

SECTION = "reproduced figures"
"""Mark of the table in the page."""


def main(arguments=None):
    """Run the command."""
    parser = argparse.ArgumentParser(prog="reproduce", description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("runs/reproduce"),
                        help="directory of table.json")
    parser.add_argument("--page", type=Path, default=Path("docs/reproduction.md"),
                        help="page whose table is written again; its pictures go to "
                             "pictures/reproduction next to it")
    options = parser.parse_args(arguments)
    pictures = options.page.parent / "pictures" / "reproduction"
    for directory in (options.output, pictures):
        directory.mkdir(parents=True, exist_ok=True)
    rows, begin_s = [], time.monotonic()
    for number, (name, study) in enumerate(STUDIES, start=1):
        print(f"[{number}/{len(STUDIES)}] {name}, {time.monotonic() - begin_s:.0f} s so far",
              file=sys.stderr)
        result = study()
        rows += result.rows
        # Write the part of each study at once, so that an interrupted run is not lost.
        (options.output / "table.json").write_text(as_json(rows), encoding="utf-8")
        for figure, drawing in result.pictures.items():
            (pictures / f"figure_{figure}.png").write_bytes(small_png(drawing))
    write_sections(options.page, {SECTION: as_markdown(rows)})
    print(as_text(rows))
    print(f"{len(rows)} rows in {time.monotonic() - begin_s:.0f} s: "
          f"{options.output / 'table.json'}, {options.page}")


if __name__ == "__main__":
    main()
