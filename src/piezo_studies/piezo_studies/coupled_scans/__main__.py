# SPDX-License-Identifier: BSD-3-Clause
"""Follow paths on the simulated XY stage, and write the errors into their study in docs."""

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path

from piezo_common.picture_style import to_png
from piezo_studies.coupled_scans.feedback_trials import feedback_table, rasters_with_feedback
from piezo_studies.coupled_scans.images import image_table, images_figure, images_of_grating
from piezo_studies.coupled_scans.marks import mark_table, rasters_marked
from piezo_studies.coupled_scans.scan_trials import TABLES, Row
from piezo_studies.coupled_scans.xy_stage import identified
from piezo_studies.marked_sections import write_sections
from piezo_studies.tables import markdown_table

PICTURE_DOTS_PER_INCH, COLOURS = 110, 64
SECTIONS = "scans: "
"""How the marks of the tables in the page begin."""


def main(arguments: list[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="coupled_scans", description=__doc__)
    parser.add_argument("--picture", type=Path, default=Path("docs/pictures/scan.png"),
                        help="picture of images to draw anew")
    parser.add_argument("--page", type=Path, default=Path("docs/studies/several_axes.md"),
                        help="page whose tables are written again; its text stays")
    options = parser.parse_args(arguments)
    model = identified()
    print(model.summary(), file=sys.stderr, flush=True)
    tables = {}

    def keep(name: str, text: str) -> None:
        tables[SECTIONS + name] = text
        print(text, file=sys.stderr, flush=True)

    for name, (_, _, trials) in TABLES.items():
        keep(name, table(name, trials(model)))
    keep("feedback", feedback_table(rasters_with_feedback(model)))
    keep("marks", mark_table(rasters_marked(model)))
    images, specimen = images_of_grating(model)
    keep("images", image_table(images, specimen))
    options.picture.write_bytes(to_png(images_figure(images), PICTURE_DOTS_PER_INCH, COLOURS))
    write_sections(options.page, tables, SECTIONS)
    print(f"{len(tables)} tables: {options.page}; drawn {options.picture}")


def table(name: str, rows: Iterable[Row]) -> str:
    """Return the rows of a table as Markdown."""
    measured, unit, _ = TABLES[name]
    return markdown_table(
        (f"{measured}, {unit}", "no inverse", "inverse of the model", "learned", "runs", "noise",
         "wanted"),
        [(row.asked, *map(_rounded, (row.none, row.inverse, row.learned)), str(row.runs),
          _rounded(row.noise), f"{row.wanted:g}") for row in rows])


def _rounded(number: float) -> str:
    """Return a number with two digits that count."""
    return f"{float(f'{number:.2g}'):g}"


if __name__ == "__main__":
    main()
