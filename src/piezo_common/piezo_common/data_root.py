# SPDX-License-Identifier: BSD-3-Clause
"""The folder in which nodes read and write files, and the valid names of files."""

import os
from contextlib import suppress
from pathlib import Path

LONGEST_NAME = 100
"""Maximum length of a name in characters; a directory listing shows it on one line."""

LONGEST_NAME_BYTES = 240
"""Maximum length of a name in bytes: file systems allow 255; a recording adds ``_0.mcap``."""

LONGEST_SHOWN = 300
"""Maximum length of a path in an error message, in characters."""

MOST_LINKS = 40
"""Maximum number of links in one path, the limit of Linux."""
LONGEST_COMPONENT_BYTES = 255
LONGEST_PATH_BYTES = 3500
"""Linux allows 4096 bytes; the files of a recording need some of them."""


class DataRootError(ValueError):
    """A path or a name is not allowed for a node; the message gives the reason and the remedy."""


class DataRoot:
    """The folder in which a node reads and writes the files of its requests.

    Any client of a node can name its files. They must lie in this folder, even through ``..``,
    absolute paths or symbolic links. A relative folder starts at the working directory, ``~`` is
    the home directory; `folder` is absolute, with all symbolic links resolved. Raises
    `DataRootError`, which names the node, if the folder does not exist.
    """

    def __init__(self, folder: str | os.PathLike, node_name: str) -> None:
        self.folder = Path(os.path.realpath(Path(folder).expanduser()))
        self._node_name = node_name
        if not self.folder.is_dir():
            raise DataRootError(f"parameter data_root is '{folder}', which is no folder: "
                                "give one that exists")

    def readable(self, path: str) -> str:
        """Return the path of a file, or of a recording's directory, to read.

        A relative path starts at the folder; an empty one is returned unchanged. Raises
        `DataRootError` if it, or a file in the directory, lies outside the folder, or it is not a
        valid path.
        """
        if not path:
            return path
        real = self._inside(path, "reads", "file")
        if (real / "metadata.yaml").exists():  # a recording
            with suppress(OSError):  # reported when the recording is read
                for entry in os.scandir(real):
                    self._inside(entry.path, "reads", "file")
        return str(self.folder / path)

    def writable(self, path: str | os.PathLike) -> Path:
        """Return the real path of a directory or a file to write, with all symbolic links resolved.

        A relative path starts at the folder; it need not exist. Raises `DataRootError` if it lies
        outside the folder, or is not a valid path.
        """
        return self._inside(os.fspath(path), "writes", "directory")

    def _inside(self, text: str, does: str, what: str) -> Path:
        """Return the real location of a path; raise `DataRootError` if it is outside the folder."""
        _check_path(text)
        real = Path(_followed(self.folder / text))
        if not real.is_relative_to(self.folder):
            raise DataRootError(
                f"{_shown(text)} is outside {self.folder}, under which the node {self._node_name} "
                f"{does}: name a {what} in there, or start the nodes with the parameter "
                "data_root set to a folder that holds both")
        return real


def _followed(path: Path) -> str:
    """Return a path with all links resolved, also those after a cycle of links."""
    real = os.path.realpath(path)
    for _ in range(MOST_LINKS):
        # After a cycle the rest is only joined and normalised, and may contain links again.
        before, real = real, os.path.realpath(real)
        if real == before:
            return real
    raise DataRootError(f"{_shown(str(path))} goes through a circle of links: "
                        "name a directory without them")


def _check_path(text: str) -> None:
    shown = _shown(text)
    if not text.isprintable():
        raise DataRootError(f"{shown} has characters that cannot be printed: "
                            "give a path without them")
    if len(os.fsencode(text)) > LONGEST_PATH_BYTES or any(
            len(os.fsencode(part)) > LONGEST_COMPONENT_BYTES for part in text.split("/")):
        raise DataRootError(f"{shown} is too long for the file system: give a shorter path")


def check_file_name(name: str, what: str) -> None:
    """Raise `DataRootError` unless a name is a plain name of a file or a directory.

    It has at most `LONGEST_NAME` characters and `LONGEST_NAME_BYTES` bytes, without separators and
    control characters, and is not hidden by a leading dot. The message says what the name is for,
    for example ``a recording``.
    """
    problem = _problem(name)
    if problem:
        raise DataRootError(f"{_shown(name)} cannot name {what}, as it {problem}: "
                            f"give a plain file name of at most {LONGEST_NAME} characters")


def _problem(name: str) -> str:
    if not name:
        return "is empty"
    if not name.isprintable():
        return "has characters that cannot be printed"
    if "/" in name or "\\" in name:
        return "has a separator of paths"
    if name.startswith("."):
        return "begins with a dot"
    if name != name.strip():
        return "begins or ends with a space"
    if len(name) > LONGEST_NAME:
        return f"has {len(name)} characters"
    if len(os.fsencode(name)) > LONGEST_NAME_BYTES:
        return f"has {len(os.fsencode(name))} bytes"
    return ""


def _shown(text: str) -> str:
    """Return a text as one printable line of bounded length."""
    return repr(text if len(text) <= LONGEST_SHOWN else text[:LONGEST_SHOWN] + "...")
