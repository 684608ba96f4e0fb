# SPDX-License-Identifier: BSD-3-Clause
"""The folder under which nodes read and write files, and the names that files may have."""

import os
from contextlib import suppress
from pathlib import Path

LONGEST_NAME = 100
"""Characters of a name; a directory listing still shows it on one line."""

LONGEST_NAME_BYTES = 240
"""File systems allow 255; a recording adds ``_0.mcap`` to its name."""

LONGEST_SHOWN = 300
"""Characters of a path in a refusal."""

MOST_LINKS = 40
"""Linux follows no more in one path."""
LONGEST_COMPONENT_BYTES = 255
LONGEST_PATH_BYTES = 3500
"""Linux allows 4096; the files of a recording need some."""


class DataRootError(ValueError):
    """A path or a name that a node neither reads nor writes: says why, and what to do."""


class DataRoot:
    """The folder under which a node reads and writes whatever it is asked to.

    Whoever reaches a node names its files. They stay under this folder, whatever ``..``, absolute
    path or symbolic link leads elsewhere.

    Parameters
    ----------
    folder : path-like
        Must exist; a relative one is taken from the working directory, ``~`` is the home directory.
    node_name : str
        Of the node, for the refusals.

    Attributes
    ----------
    folder : Path
        Absolute, with all symbolic links followed.

    Raises
    ------
    DataRootError
        If there is no such folder.
    """

    def __init__(self, folder: str | os.PathLike, node_name: str) -> None:
        self.folder = Path(os.path.realpath(Path(folder).expanduser()))
        self._node_name = node_name
        if not self.folder.is_dir():
            raise DataRootError(f"parameter data_root is '{folder}', which is no folder: "
                                "give one that exists")

    def readable(self, path: str) -> str:
        """Return the path of a file, or of a recording's directory, to read.

        Parameters
        ----------
        path : str
            A relative one is taken from the folder; empty for none, which it stays.

        Raises
        ------
        DataRootError
            If it, or a file in the directory, lies outside the folder, or it cannot be a path.
        """
        if not path:
            return path
        real = self._inside(path, "reads", "file")
        if (real / "metadata.yaml").exists():  # of a recording
            with suppress(OSError):  # its reader says why
                for entry in os.scandir(real):
                    self._inside(entry.path, "reads", "file")
        return str(self.folder / path)

    def writable(self, path: str | os.PathLike) -> Path:
        """Return where a directory or a file that is to be written really lies.

        Parameters
        ----------
        path : path-like
            A relative one is taken from the folder. It need not exist.

        Returns
        -------
        Path
            Absolute, with all symbolic links followed.

        Raises
        ------
        DataRootError
            If it lies outside the folder, or cannot be a path.
        """
        return self._inside(os.fspath(path), "writes", "directory")

    def _inside(self, text: str, does: str, what: str) -> Path:
        """Return where a path really lies; raise `DataRootError` where that is outside."""
        _check_path(text)
        real = Path(_followed(self.folder / text))
        if not real.is_relative_to(self.folder):
            raise DataRootError(
                f"{_shown(text)} is outside {self.folder}, under which the node {self._node_name} "
                f"{does}: name a {what} in there, or start the nodes with the parameter "
                "data_root set to a folder that holds both")
        return real


def _followed(path: Path) -> str:
    """Return a path with all links followed, also those behind a circle of links."""
    real = os.path.realpath(path)
    for _ in range(MOST_LINKS):
        # Behind a circle the rest is only joined and normalised, and may hold links again.
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
    """Refuse what is not the plain name of a file or a directory.

    Parameters
    ----------
    name : str
        At most `LONGEST_NAME` characters and `LONGEST_NAME_BYTES` bytes, without separators and
        control characters, not hidden by a leading dot.
    what : str
        What it is to name, for the refusal, such as ``a recording``.

    Raises
    ------
    DataRootError
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
    """Return a text as one line of bounded length, whatever is in it."""
    return repr(text if len(text) <= LONGEST_SHOWN else text[:LONGEST_SHOWN] + "...")
