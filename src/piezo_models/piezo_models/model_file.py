# SPDX-License-Identifier: BSD-3-Clause
"""The model file: one versioned JSON document, written atomically and read strictly."""

import json
from pathlib import Path

from piezo_common.text_file import (
    UnreadableFile,
    is_something_else,
    read_bounded_text,
    replace_text,
)
from piezo_models.model_document import FORMAT, ModelFileError, document_of, rendered
from piezo_models.model_reader import identified_model_of

# A density of 1000 x 1000 cells fits.
_LARGEST_FILE_BYTES = 32 * 2**20


def save_model(path, identified):
    """Write a model file; the file at `path` is replaced at once or not at all.

    Parameters
    ----------
    path : path-like
    identified : IdentifiedModel

    Raises
    ------
    ModelFileError
        If the model does not satisfy what `load_model` asks for, or the file cannot be written,
        or there is one that is no model file.
    """
    path = Path(path)
    document = document_of(identified)
    identified_model_of(document, path)
    if is_something_else(path, FORMAT, _LARGEST_FILE_BYTES):
        raise ModelFileError(
            f"{path}: is there already and is no model file, so it is not overwritten; "
            "choose another name"
        )
    try:
        replace_text(path, rendered(document) + "\n")
    except OSError as error:
        raise ModelFileError(
            f"{path}: cannot be written ({error.strerror}); choose a writable directory"
        ) from error


def load_model(path):
    """Read a model file.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    IdentifiedModel

    Raises
    ------
    ModelFileError
        If the file is missing, is not a model file of this version, or has a missing, unknown or
        invalid field.
    """
    path = Path(path)
    try:
        text = read_bounded_text(path, _LARGEST_FILE_BYTES)
    except UnreadableFile as error:
        raise ModelFileError(f"{path}: {error}; give a model file") from None
    try:
        document = json.loads(text, object_pairs_hook=_unique, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise ModelFileError(
            f"{path}: is not valid JSON ({error}); save the model again"
        ) from error
    return identified_model_of(document, path)


def _unique(pairs):
    fields = {}
    for name, value in pairs:
        if name in fields:
            raise ValueError(f"field {name} is repeated")
        fields[name] = value
    return fields


def _refuse_constant(name):
    raise ValueError(f"{name} is no number")
