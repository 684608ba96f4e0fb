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
from piezo_studies.coupled_scans.trials import TABLES, Row
from piezo_studies.coupled_scans.xy_stage import identified
from piezo_studies.marked_sections import with_sections

PICTURE_DOTS_PER_INCH, COLOURS = 110, 64
IMAGES = "images"
SECTIONS = "scans: "
"""How the marks of the tables in the page begin."""


def main(arguments: list[str] | None = None) -> None:
    """Run the command.

    Parameters
    ----------
    arguments : list of str, optional
        Those of the command line by default.
    """
    parser = argparse.ArgumentParser(prog="coupled_scans", description=__doc__)
    parser.add_argument("--picture", type=Path, default=Path("docs/pictures/scan.png"),
                        help="picture of images to draw anew")
    parser.add_argument("--page", type=Path, default=Path("docs/studies/several_axes.md"),
                        help="page whose tables are written again; its text stays")
    options = parser.parse_args(arguments)
    model = identified()
    print(model.summary(), file=sys.stderr, flush=True)
    tables = {}
    for name, (_, _, trials) in TABLES.items():
        tables[SECTIONS + name] = table(name, trials(model))
        print(tables[SECTIONS + name], file=sys.stderr, flush=True)
    tables[SECTIONS + "feedback"] = feedback_table(rasters_with_feedback(model))
    print(tables[SECTIONS + "feedback"], file=sys.stderr, flush=True)
    tables[SECTIONS + "marks"] = mark_table(rasters_marked(model))
    print(tables[SECTIONS + "marks"], file=sys.stderr, flush=True)
    images, specimen = images_of_grating(model)
    tables[SECTIONS + IMAGES] = image_table(images, specimen)
    print(tables[SECTIONS + IMAGES], file=sys.stderr, flush=True)
    options.picture.write_bytes(to_png(images_figure(images), PICTURE_DOTS_PER_INCH, COLOURS))
    options.page.write_text(with_sections(
        options.page.read_text(encoding="utf-8"), tables, SECTIONS), encoding="utf-8")
    print(f"{len(tables)} tables: {options.page}; drawn {options.picture}")


def table(name: str, rows: Iterable[Row]) -> str:
    """Return the rows of a table as Markdown."""
    measured, unit, _ = TABLES[name]
    lines = [f"| {measured}, {unit} | no inverse | inverse of the model | learned | runs | noise | "
             "wanted |", "|---|---|---|---|---|---|---|"]
    lines += [f"| {row.asked} | {_rounded(row.none)} | {_rounded(row.inverse)} | "
              f"{_rounded(row.learned)} | {row.runs} | {_rounded(row.noise)} | {row.wanted:g} |"
              for row in rows]
    return "\n".join(lines) + "\n"


def _rounded(number: float) -> str:
    """Return a number with two digits that count."""
    return f"{float(f'{number:.2g}'):g}"


if __name__ == "__main__":
    main()
