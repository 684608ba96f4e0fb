# SPDX-License-Identifier: BSD-3-Clause
"""Opening files named by others: only regular ones of a bounded size."""

import os
import stat
from io import FileIO
from os import PathLike

KINDS = {stat.S_IFDIR: "a directory", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket",
         stat.S_IFCHR: "a device", stat.S_IFBLK: "a device"}


class UnreadableFile(ValueError):
    """A file was not read; the message gives the reason without the file's name."""


def open_regular(path: str | PathLike[str], largest_bytes: int) -> FileIO:
    """Open a regular file of a bounded size for reading, without a buffer.

    Pipes, which would block, and devices, which may have no end, are rejected. A read returns the
    available data at once, so that reading a slow file can be stopped. Raises `UnreadableFile` if
    the file is not regular, or is too large, and OSError if it cannot be opened.
    """
    _check(os.stat(path), largest_bytes)
    stream = open(path, "rb", buffering=0, opener=_without_waiting)
    try:
        _check(os.fstat(stream.fileno()), largest_bytes)  # the file may have been replaced
    except UnreadableFile:
        stream.close()
        raise
    return stream


def _without_waiting(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))  # missing on Windows


def _check(found: os.stat_result, largest_bytes: int) -> None:
    kind = stat.S_IFMT(found.st_mode)
    if kind != stat.S_IFREG:
        raise UnreadableFile(f"is {KINDS.get(kind, 'something else')}, not a regular file")
    if found.st_size > largest_bytes:
        raise UnreadableFile(
            f"has {found.st_size} bytes, more than the {largest_bytes} of any such file")
