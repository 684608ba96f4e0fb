# SPDX-License-Identifier: BSD-3-Clause
"""The directory of a run of the demo; that of an earlier run is renamed."""

import json
from datetime import datetime
from pathlib import Path

MARK = "run.json"


def claim_directory(path, command):
    """Make a directory for a run, and store the command line of the user in it.

    An empty directory is used as it is. A directory of an earlier run is renamed with the start
    time of that run, so that no recording is overwritten; its new path is returned. ValueError is
    raised if the directory holds anything else, or cannot be created.
    """
    path = Path(path)
    try:
        earlier = _move_aside(path)
        path.mkdir(parents=True, exist_ok=True)
        _write_mark(path, {"began": datetime.now().astimezone().isoformat(timespec="seconds"),
                           "command": command})
    except OSError as error:
        raise ValueError(f"{path} cannot be made ({error.strerror}): "
                         "name another directory with --output") from None
    return earlier


def _move_aside(path):
    if not path.exists() or path.is_dir() and not any(path.iterdir()):
        return None
    earlier = _free_sibling(path, _began(path))
    return path.rename(earlier)


def _began(path):
    try:
        return json.loads((path / MARK).read_text(encoding="utf-8"))["began"]
    except (OSError, ValueError, KeyError, TypeError):
        raise ValueError(f"{path} holds something else than a run of the demo: "
                         "name another directory with --output") from None


def _free_sibling(path, began):
    stem = f"{path.name}_{began[:19].replace(':', '-')}"
    number, sibling = 1, path.with_name(stem)
    while sibling.exists():
        number += 1
        sibling = path.with_name(f"{stem}_{number}")
    return sibling


def _write_mark(path, content):
    (path / MARK).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
