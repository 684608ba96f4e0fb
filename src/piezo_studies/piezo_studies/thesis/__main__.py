# SPDX-License-Identifier: BSD-3-Clause
"""Run all studies: print the table, and write it as JSON and, with pictures, into a page."""

import argparse
import sys
import time
from pathlib import Path

from piezo_studies.marked_sections import write_sections
from piezo_studies.thesis import (
    chirp_response,
    compensation,
    designed_hysteresis,
    excitation,
    feedback_figures,
    identified_stage,
    inverse_feedforward,
    known_density,
    known_dynamics,
    learned_tracking,
    multirate_tracking,
    multisine_dynamics,
    one_sine,
    scanning,
    slow_hysteresis,
    slow_tracking,
    stepwise_inversion,
    unseen_inputs,
)
from piezo_studies.thesis.figure_table import as_json, as_markdown, as_text
from piezo_studies.thesis.pictures import small_png

STUDIES = (
    ("a density from one sine", one_sine.study),
    ("compensation with an offset", compensation.study),
    ("slow hysteresis of the stage", slow_hysteresis.study),
    ("slow tracking by PID and composite", slow_tracking.study),
    ("hysteresis from designed samples", designed_hysteresis.study),
    ("dynamics from six sines", multisine_dynamics.study),
    ("inversion by steps", stepwise_inversion.study),
    ("scanning by PI and composite", scanning.study),
    ("creep and dynamics of a known plant", known_dynamics.study),
    ("density of a known plant", known_density.study),
    ("frequency response by a chirp", chirp_response.study),
    ("the stage step by step", identified_stage.study),
    ("the stage's model on unseen input", unseen_inputs.study),
    ("inverse feedforward", inverse_feedforward.study),
    ("feedback design", feedback_figures.study),
    ("multirate and single-rate tracking", multirate_tracking.study),
    ("learned tracking", learned_tracking.study),
    ("excitation of the designed input", excitation.study),
)


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
