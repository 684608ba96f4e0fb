# SPDX-License-Identifier: BSD-3-Clause
"""The model file: one versioned JSON document, written atomically and read with strict checks."""

import json
from os import PathLike
from pathlib import Path
from typing import Any

from piezo_common.regular_file import UnreadableFile
from piezo_common.schema import SchemaError, load_document
from piezo_common.text_file import check_may_replace, read_bounded_text, replace_document
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_document import (
    FORMAT,
    ModelDocument,
    ModelFileError,
    document_of,
    rendered,
)
from piezo_models.model_reader import built_model, identified_model_of

KIND = "model file"
"""Name of such files in messages."""

LARGEST_FILE_BYTES = 32 * 2**20
"""Size limit of a model file in bytes; a density of 1000 x 1000 cells fits."""


def save_model(path: str | PathLike[str], identified: IdentifiedModel) -> None:
    """Write a model file; the file at `path` is replaced in one step or not at all.

    Raises
    ------
    ModelFileError
        If `load_model` would reject the model, the file cannot be written, or a file that is not
        a model file is in its place.

    Examples
    --------
    >>> from piezo_models import (
    ...     CreepDynamics, ElectricVibrationDynamics, PreisachModel, StageModel)
    >>> line = PreisachModel.line(0.0, 10.0, 2.0)
    >>> stage = StageModel(line, CreepDynamics(), ElectricVibrationDynamics())
    >>> save_model("line.json", IdentifiedModel(stage, voltage_range_v=(0.0, 10.0)))
    >>> load_model("line.json").voltage_range_v
    (0.0, 10.0)
    """
    path = Path(path)
    document = document_of(identified)
    identified_model_of(document, path)
    write_document(path, document)


def write_document(path: Path, document: dict[str, Any]) -> None:
    """Write a checked model document, of one axis or of several; see `save_model`."""
    replace_document(path, document, KIND, ModelFileError, rendered, LARGEST_FILE_BYTES)


def check_model_may_replace(path: str | PathLike[str]) -> None:
    """Raise `ModelFileError`, also before the work, if another kind of file is in place."""
    check_may_replace(path, FORMAT, KIND, ModelFileError, LARGEST_FILE_BYTES)


def announced_model(path: str | PathLike[str]) -> IdentifiedModel:
    """Read a model file for a command and print the model's shortfall; see `load_model`."""
    identified = load_model(path)
    if identified.shortfall():
        print(identified.shortfall(), flush=True)
    return identified


def is_of_several_axes(path: str | PathLike[str]) -> bool:
    """Return True if a model file has several axes; False if it cannot be read."""
    try:
        content = json.loads(read_bounded_text(path, LARGEST_FILE_BYTES))
    except (UnreadableFile, ValueError, RecursionError):
        return False
    return isinstance(content, dict) and content.get("format") == FORMAT and "axes" in content


def load_model(path: str | PathLike[str]) -> IdentifiedModel:
    """Read a model file of one axis.

    Raises
    ------
    ModelFileError
        If the file is missing, is not a model file of this version, is one of several axes, or has
        a missing, unknown or invalid field.
    """
    if is_of_several_axes(path):
        raise ModelFileError(f"{path}: is a model of several axes, which track, simulate, "
                             "diagnose, design, scan and Python take; give a model of one axis")
    try:
        return built_model(load_document(ModelDocument, path, LARGEST_FILE_BYTES))
    except SchemaError as error:
        raise ModelFileError(f"{path}: {error}") from None
