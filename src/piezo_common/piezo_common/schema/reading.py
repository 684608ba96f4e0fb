# SPDX-License-Identifier: BSD-3-Clause
"""Read a file of a schema: bounded, strictly parsed, of the right format and version."""

import json
from os import PathLike
from typing import Any, TypeVar

from piezo_common.regular_file import UnreadableFile
from piezo_common.schema.checking import SchemaError, check, quoted
from piezo_common.schema.fields import Document
from piezo_common.text_file import LARGEST_BYTES, read_bounded_text

D = TypeVar("D", bound=Document)


def load_document(kind: type[D], path: str | PathLike[str],
                  largest_bytes: int = LARGEST_BYTES) -> D:
    """Read a file of bounded size, and check it against a class of documents.

    Raises `SchemaError` if it cannot be read, has another format or version, or does not fit.
    """
    try:
        text = read_bounded_text(path, largest_bytes)
    except UnreadableFile as error:
        raise SchemaError(str(error), f"give a {kind.TITLE}") from None
    return parsed(kind, text)


def parsed(kind: type[D], text: str) -> D:
    """Parse and check the text of a file; see `load_document`."""
    return checked(kind, _yaml(text, kind) if kind.SYNTAX == "yaml" else _json(text, kind))


def checked(kind: type[D], content: object) -> D:
    """Check parsed content, format and version first; see `load_document`."""
    if kind.FORMAT:
        found = content.get("format") if isinstance(content, dict) else content
        if not isinstance(content, dict) or found != kind.FORMAT:
            raise SchemaError(f'format is {quoted(found)}, not "{kind.FORMAT}"',
                              f"give a {kind.TITLE}")
    if kind.VERSION:
        version = content.get("version") if isinstance(content, dict) else None
        if version != kind.VERSION or isinstance(version, bool):
            raise SchemaError(f"version is {quoted(version)}, not {kind.VERSION}", kind.RENEW)
    return check(kind, content, renew=kind.RENEW)


def _json(text: str, kind: type[Document]) -> object:
    try:
        return json.loads(text, object_pairs_hook=_unique)
    except (ValueError, RecursionError) as error:
        reason = " ".join(str(error).split())
        raise SchemaError(f"is not valid JSON ({reason})", f"give a {kind.TITLE}") from None


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    fields: dict[str, Any] = {}
    for name, value in pairs:
        if name in fields:
            raise ValueError(f"field {name} is repeated")
        fields[name] = value
    return fields


def _yaml(text: str, kind: type[Document]) -> object:
    import yaml  # imported here, as JSON files do not need it

    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        reason = " ".join(str(error).split())
        raise SchemaError(f"is not valid YAML ({reason})", f"give a {kind.TITLE}") from None
