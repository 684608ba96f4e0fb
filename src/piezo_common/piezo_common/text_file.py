# SPDX-License-Identifier: BSD-3-Clause
"""Text files: read up to a bound, replaced as a whole, none that is something else."""

import json
import os
from os import PathLike
from pathlib import Path

LARGEST_BYTES = 10_000_000


class UnreadableFile(ValueError):
    """A file that is not read; the message says why, without its name."""


def read_bounded_text(path: str | PathLike[str], largest_bytes: int = LARGEST_BYTES) -> str:
    """Read a text file of a bounded size.

    Parameters
    ----------
    path : path-like
    largest_bytes : int

    Returns
    -------
    str

    Raises
    ------
    UnreadableFile
        If the file is missing, too large or not UTF-8.
    """
    path = Path(path)
    try:
        size = path.stat().st_size
        if size > largest_bytes:
            raise UnreadableFile(
                f"has {size} bytes, more than the {largest_bytes} of any such file")
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise UnreadableFile(f"cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise UnreadableFile("is not text") from None


def replace_text(path: str | PathLike[str], text: str) -> None:
    """Write a file; one that is there already is replaced as a whole or not at all.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with temporary.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def is_something_else(path: str | PathLike[str], file_format: str,
                      largest_bytes: int = LARGEST_BYTES) -> bool:
    """Tell whether a file is there that is not JSON of a format, such as a recording.

    Parameters
    ----------
    path : path-like
    file_format : str
        What its entry ``format`` says.
    largest_bytes : int
    """
    if not Path(path).exists():
        return False
    try:
        document = json.loads(read_bounded_text(path, largest_bytes))
    except (ValueError, RecursionError):
        return True
    return not isinstance(document, dict) or document.get("format") != file_format
