# SPDX-License-Identifier: BSD-3-Clause
"""Write the tables of fields in docs/files.md from the schemas of the files.

    python tools/file_tables.py [--check]

A table stands between two comments, `fields of NAME` and `end`; the text around them is written by
hand and stays.
"""

import sys
from collections.abc import Iterator
from importlib import import_module
from typing import Any, Literal, get_args, get_origin

from generated_page import ROOT, write_or_check
from pydantic.fields import FieldInfo

from piezo_common.schema.fields import Document, NumberOrNumbers, NumberTree, Part
from piezo_studies.marked_sections import with_sections

PAGE = ROOT / "docs" / "files.md"
DOCUMENTS = {
    "model": "piezo_models.model_document:ModelDocument",
    "axes_model": "piezo_models.axes_model_file:AxesDocument",
    "controller": "piezo_controller.feedback.controller_file:ControllerDocument",
    "law": "piezo_models.feedback_law.axes_law:LawDocument",
    "weights": "piezo_controller.feedback.synthesis.weights:DesignWeights",
    "learned": "piezo_controller.learning.learned_file:LearnedDocument",
    "calibration": "piezo_stage_driver.backends.calibration:Calibration",
    "axes_calibration": "piezo_stage_driver.backends.calibration:AxesCalibration",
    "pi_gcs": "piezo_stage_driver.backends.pi_gcs_stage:PiSettings",
    "axes_pi_gcs": "piezo_stage_driver.backends.pi_gcs_stage:PiAxesSettings",
    "nv200": "piezo_stage_driver.backends.nv200_stage:Nv200Settings",
    "columns": "piezo_recorder.reading.columns:ColumnsDocument",
    "arrays": "piezo_recorder.reading.axes:ArraysDocument",
    "scan": "piezo_recorder.images.scan_frame:ScanFrame",
    "probe": "piezo_identification.experiments.probing.probe_file:ProbeDocument",
    "plant": "piezo_sim.plant.plant_file:PlantDocument",
    "axes_plant": "piezo_sim.plant.plant_file:AxesPlantDocument",
}
SECTIONS = "fields of "
HEAD = "| field | type | unit | range | meaning |\n|---|---|---|---|---|\n"
RANGES = {"gt": "> {:g}", "ge": ">= {:g}", "lt": "< {:g}", "le": "<= {:g}",
          "min_length": "{} or more entries", "max_length": "{} or fewer entries"}
NAMES = {float: "number", int: "whole number", str: "text", bool: "true or false",
         Any: "anything", type(None): "nothing"}


def main(arguments: list[str] | None = None) -> int:
    """Write the page, or with ``--check`` only say whether it is up to date."""
    return write_or_check(PAGE, page, __doc__, arguments)


def page() -> str:
    """Return the text of the page with its tables written anew.

    Raises
    ------
    ValueError
        If the page lacks the section of a document, or has one too many.
    """
    return with_sections(PAGE.read_text(encoding="utf-8"),
                         {SECTIONS + name: table_of(name) for name in DOCUMENTS}, SECTIONS)


def table_of(name: str) -> str:
    """Return the table of a document by its short name."""
    module, _, kind = DOCUMENTS[name].partition(":")
    return table(getattr(import_module(module), kind))


def table(kind: type[Document]) -> str:
    """Return the table of a document's fields, those of its parts under their own path."""
    return HEAD + "".join(_rows(kind, ""))


def _rows(kind: type[Part], prefix: str) -> Iterator[str]:
    for name, field in kind.model_fields.items():
        extra = field.json_schema_extra
        unit = extra.get("unit", "") if isinstance(extra, dict) else ""
        optional = "" if field.is_required() else " (may be left out)"
        cells = (f"`{prefix}{name}`", type_name(field.annotation), unit, range_of(field),
                 f"{field.description or ''}{optional}")
        yield "| " + " | ".join(str(cell) for cell in cells) + " |\n"
        part = _part(field.annotation)
        if part:
            origin = get_origin(field.annotation)
            within = "[]" if origin is list else ".NAME" if origin is dict else ""
            yield from _rows(part, f"{prefix}{name}{within}.")


def type_name(annotation: Any) -> str:
    """Return what a reader of the documentation calls a type."""
    if annotation is NumberTree:
        return "numbers by name, nested"
    if annotation == NumberOrNumbers:
        return "number or list of numbers"
    if annotation in NAMES:
        return NAMES[annotation]
    if isinstance(annotation, type) and issubclass(annotation, Part):
        return "object"
    if hasattr(annotation, "__metadata__"):
        return type_name(annotation.__origin__)
    arguments = [entry for entry in get_args(annotation) if entry is not type(None)]
    origin = get_origin(annotation)
    if origin is Literal:
        return " or ".join(f'"{choice}"' for choice in arguments)
    if origin is list:
        return f"list of {_plural(type_name(arguments[0]))}"
    if origin is dict:
        return f"{_plural(type_name(arguments[1]))} by name"
    return type_name(arguments[0])


def _plural(name: str) -> str:
    first, of, others = name.partition(" of ")
    return name if name == "anything" or " or " in name else f"{first}s{of}{others}"


def range_of(field: FieldInfo) -> str:
    """Return the range of a number, or of the numbers and the length of a list."""
    limits = [*_limits(field.annotation), *field.metadata]
    return ", ".join(word.format(getattr(limit, name)) for limit in limits
                     for name, word in RANGES.items() if getattr(limit, name, None) is not None)


def _limits(annotation: Any) -> Iterator[Any]:
    """Yield what limits the numbers that a list or an object holds."""
    for part in get_args(annotation):
        for info in getattr(part, "__metadata__", ()):
            yield from getattr(info, "metadata", ())
        yield from _limits(part)


def _part(annotation: Any) -> type[Part] | None:
    """Return the class of parts that a type holds, if it holds one."""
    if isinstance(annotation, type) and issubclass(annotation, Part):
        return annotation
    return next(filter(None, map(_part, get_args(annotation))), None)


if __name__ == "__main__":
    sys.exit(main())
