# SPDX-License-Identifier: BSD-3-Clause
"""Read a text file that people may have mistaken for a small one."""

from pathlib import Path

LARGEST_BYTES = 10_000_000


class UnreadableFile(ValueError):
    """A file that is not read; the message says why, without its name."""


def read_bounded_text(path, largest_bytes=LARGEST_BYTES):
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
