# SPDX-License-Identifier: BSD-3-Clause
"""Text files: bounded reading, atomic replacement, and protection of earlier and other files."""

import filecmp
import io
import json
import logging
import os
import shutil
from collections.abc import Callable, Mapping
from os import PathLike
from pathlib import Path
from typing import Any

from piezo_common.cancellation import check_cancelled
from piezo_common.regular_file import UnreadableFile, open_regular

LARGEST_BYTES = 10_000_000
PART_BYTES = 1 << 18
PREVIOUS = ".previous"
"""End of the stem of an earlier version that is kept."""

log = logging.getLogger(__name__)


def json_text(document: Mapping[str, Any]) -> str:
    """Return a document as indented JSON; raise ValueError if a value is not finite."""
    return json.dumps(document, indent=1, allow_nan=False)


def read_bounded_text(path: str | PathLike[str], largest_bytes: int = LARGEST_BYTES) -> str:
    """Read a text file of a bounded size; this can be cancelled between its parts.

    Raises `UnreadableFile` if the file is missing, not regular, too large or not UTF-8.
    """
    content = bytearray()
    try:
        with open_regular(path, largest_bytes) as stream:
            # One more byte detects a growing file, or one without a size as in /proc.
            while part := stream.read(min(PART_BYTES, largest_bytes + 1 - len(content))):
                check_cancelled()
                content += part
    except OSError as error:
        raise UnreadableFile(f"cannot be read ({error.strerror})") from None
    if len(content) > largest_bytes:
        raise UnreadableFile(f"has more than the {largest_bytes} bytes of any such file")
    try:
        return io.TextIOWrapper(io.BytesIO(content), encoding="utf-8").read()
    except UnicodeDecodeError:
        raise UnreadableFile("is not text") from None


def replace_text(path: str | PathLike[str], text: str) -> None:
    """Write a file; an existing one is replaced in one step or not at all.

    An existing file with another text is kept, see `keep_previous`. Raises OSError.
    """
    path = Path(path)
    temporary, earlier = (
        path.with_name(f".{path.name}.{os.getpid()}.{ending}") for ending in ("tmp", "earlier"))
    try:
        with temporary.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        if path.exists() and not filecmp.cmp(path, temporary, shallow=False):
            shutil.copy2(path, earlier)
            keep_previous(path, earlier)
        os.replace(temporary, path)
    finally:
        for left in (temporary, earlier):
            left.unlink(missing_ok=True)


def previous_of(path: Path) -> Path:
    """Return where the earlier version of a file is kept: ``NAME.previous.json`` of a JSON file."""
    return path.with_name(f"{path.stem}{PREVIOUS}{path.suffix}")


def keep_previous(path: Path, earlier: Path | None = None) -> None:
    """Rename the earlier version of a file, and report it as a warning of `logging`.

    It becomes `previous_of` the path and replaces an older one. By default the earlier version is
    at the path. Raises OSError if it cannot be renamed.
    """
    previous = previous_of(path)
    os.replace(earlier or path, previous)
    log.warning("%s: the earlier file is kept as %s", path, previous.name)


def replace_json(path: str | PathLike[str], document: Mapping[str, Any]) -> None:
    """Write a document as JSON; see `replace_text`. Raises ValueError if a value is not finite."""
    replace_text(path, json_text(document) + "\n")


def replace_document(path: str | PathLike[str], document: Mapping[str, Any], kind: str,
                     error: type[ValueError],
                     rendered: Callable[[Mapping[str, Any]], str] = json_text,
                     largest_bytes: int = LARGEST_BYTES) -> None:
    """Write a JSON file, and replace one of the same format only; see `replace_text`.

    The entry ``format`` of the document distinguishes the file from others. `kind` is the name of
    such files in messages, and `rendered` returns the text of the document. Raise the given
    `error`, with the path, the cause, and what to do, if a file of another format is in its place,
    a value is not finite, or the file cannot be written.
    """
    check_may_replace(path, document["format"], kind, error, largest_bytes)
    try:
        replace_text(path, rendered(document) + "\n")
    except OSError as failure:
        raise error(f"{path}: cannot be written ({failure.strerror}); choose a directory that "
                    "exists and is writable") from None
    except ValueError:
        raise error(f"{path}: the {kind} would hold a value that is not finite; "
                    "make it again") from None


def check_may_replace(path: str | PathLike[str], file_format: str, kind: str,
                      error: type[ValueError], largest_bytes: int = LARGEST_BYTES) -> None:
    """Raise an error if a file of another format is in a place, also before the work for it.

    For the arguments see `replace_document`.
    """
    if is_something_else(path, file_format, largest_bytes):
        raise error(f"{path}: is there already and is no {kind}, so it is not overwritten; "
                    "choose another name")


def is_something_else(path: str | PathLike[str], file_format: str,
                      largest_bytes: int = LARGEST_BYTES) -> bool:
    """Return True if a file exists that is not JSON of a format, for example a recording.

    The format is the value of its entry ``format``.
    """
    if not Path(path).exists():
        return False
    try:
        document = json.loads(read_bounded_text(path, largest_bytes))
    except (ValueError, RecursionError):
        return True
    return not isinstance(document, dict) or document.get("format") != file_format
