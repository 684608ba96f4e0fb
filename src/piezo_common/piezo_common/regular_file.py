# SPDX-License-Identifier: BSD-3-Clause
"""Files that somebody else names: only regular ones of a bounded size are opened."""

import os
import stat
from io import FileIO
from os import PathLike

KINDS = {stat.S_IFDIR: "a directory", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket",
         stat.S_IFCHR: "a device", stat.S_IFBLK: "a device"}


class UnreadableFile(ValueError):
    """A file that is not read; the message says why, without its name."""


def open_regular(path: str | PathLike[str], largest_bytes: int) -> FileIO:
    """Open a regular file of a bounded size for reading, without a buffer.

    Neither a pipe, which would block, nor a device, which may have no end, is opened.

    Returns
    -------
    raw binary stream
        A read of it returns what there is at once, so that a slow file can be given up.

    Raises
    ------
    UnreadableFile
        If the file is not a regular one, or is too large.
    OSError
        If it cannot be opened.
    """
    _check(os.stat(path), largest_bytes)
    stream = open(path, "rb", buffering=0, opener=_without_waiting)
    try:
        _check(os.fstat(stream.fileno()), largest_bytes)  # it may have been exchanged meanwhile
    except UnreadableFile:
        stream.close()
        raise
    return stream


def _without_waiting(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))  # which Windows has not


def _check(found: os.stat_result, largest_bytes: int) -> None:
    kind = stat.S_IFMT(found.st_mode)
    if kind != stat.S_IFREG:
        raise UnreadableFile(f"is {KINDS.get(kind, 'something else')}, not a regular file")
    if found.st_size > largest_bytes:
        raise UnreadableFile(
            f"has {found.st_size} bytes, more than the {largest_bytes} of any such file")
