# SPDX-License-Identifier: BSD-3-Clause
"""Write the tables of fields in docs/files.md from the schemas of the files.

    python tools/file_tables.py [--check]

A table stands between two comments, `fields of NAME` and `end`; the text around them is written by
hand and stays.
"""

import argparse
import sys
from importlib import import_module
from pathlib import Path

from piezo_common.marked_sections import with_sections
from piezo_common.schema.tables import table

PAGE = Path(__file__).parents[1] / "docs" / "files.md"
DOCUMENTS = {
    "model": "piezo_models.model_document:ModelDocument",
    "axes_model": "piezo_models.axes_model_file:AxesDocument",
    "controller": "piezo_controller.feedback.controller_file:ControllerDocument",
    "weights": "piezo_controller.feedback.synthesis.weights_document:WeightsDocument",
    "learned": "piezo_controller.learning.learned_file:LearnedDocument",
    "calibration": "piezo_stage_driver.backends.calibration:Calibration",
    "pi_gcs": "piezo_stage_driver.backends.pi_gcs_stage:PiSettings",
    "nv200": "piezo_stage_driver.backends.nv200_stage:Nv200Settings",
    "columns": "piezo_recorder.reading.columns:ColumnsDocument",
    "arrays": "piezo_recorder.reading.axes:ArraysDocument",
    "probe": "piezo_identification.experiments.probing.probe_file:ProbeDocument",
    "plant": "piezo_sim.plant.plant_file:PlantDocument",
}
SECTIONS = "fields of "


def main(arguments: list[str] | None = None) -> int:
    """Write the page, or with ``--check`` only say whether it is up to date."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing; status 1 if outdated")
    options = parser.parse_args(arguments)
    before = PAGE.read_text(encoding="utf-8")
    after = page(before)
    if not options.check:
        PAGE.write_text(after, encoding="utf-8")
    elif before != after:
        print("file_tables: docs/files.md is outdated: run make docs", file=sys.stderr)
        return 1
    return 0


def page(text: str) -> str:
    """Return the text of the page with its tables written anew.

    Raises
    ------
    ValueError
        If the page lacks the section of a document, or has one too many.
    """
    return with_sections(text, {SECTIONS + name: table_of(name) for name in DOCUMENTS}, SECTIONS)


def table_of(name: str) -> str:
    """Return the table of a document by its short name."""
    module, _, kind = DOCUMENTS[name].partition(":")
    return table(getattr(import_module(module), kind))


if __name__ == "__main__":
    sys.exit(main())
