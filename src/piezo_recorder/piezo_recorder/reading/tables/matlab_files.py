# SPDX-License-Identifier: BSD-3-Clause
"""MATLAB files of versions 4 to 7, read by a process that a damaged file may crash."""

import json
import os
import struct
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from piezo_recorder.reading.recording import RecordingError
from piezo_recorder.reading.tables.array_files import Group, damage_reported, tables_of
from piezo_recorder.reading.tables.table import Progress, Table

READER = Path(__file__).with_name("matlab_contents.py")

LEAST_LIMIT_S, SECONDS_PER_BYTE = 60.0, 1e-6
"""Time limit of the reading, which takes some ten nanoseconds per byte."""

LEAST_LIMIT_BYTES, EXPANSION = 4_000_000_000, 40
"""Memory limit of the reading: memory that NumPy and SciPy map, and expansion of a file."""

ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1"}
"""Each further thread of OpenBLAS would map memory that counts towards the limit."""

LONGEST_NAME = 64


def is_version_4(head: bytes) -> bool:
    """Return whether a file is MATLAB version 4, which has no magic, by its first matrix header."""
    if len(head) < 20:
        return False
    for order in "<>":
        kind, _, _, imaginary, length = struct.unpack(order + "5i", head[:20])
        name = head[20 : 20 + length].removesuffix(b"\0").replace(b"_", b"")
        if (0 <= kind < 5000 and kind % 10 <= 2 and kind // 10 % 10 <= 5 and kind // 100 % 10 == 0
                and imaginary in (0, 1) and 1 < length <= LONGEST_NAME
                and head[19 + length : 20 + length] == b"\0" and name.isalnum()):
            return True
    return False


def read_matlab(path: Path, progress: Progress) -> list[Table]:
    """Read the variables of a MATLAB file of version 4 to 7; a structure is a group.

    RecordingError is raised if the file is damaged, or holds no numeric arrays.
    """
    with damage_reported(path, "MATLAB file"), TemporaryDirectory() as folder:
        arrays_file = Path(folder) / "arrays.npz"
        variables, names = _read_apart(path, arrays_file)
        groups = {"": Group("")}
        with np.load(arrays_file) as arrays:
            for name, number in zip(names, arrays.files, strict=True):
                title, _, own = name.rpartition(".")
                groups.setdefault(title, Group(title)).take(own, arrays[number])
    progress(f"read {path.name}", 1.0)
    tables = tables_of(path, list(groups.values()))
    if not tables:
        raise RecordingError(
            f"{path} holds no numeric arrays ({', '.join(variables) or 'nothing'}): save time, "
            "voltage and displacement as vectors, not as a table or timetable")
    return tables


def _read_apart(path: Path, target: Path) -> tuple[list[str], list[str]]:
    """Return the names of the variables, and of the numeric arrays that were written to a file."""
    size = path.stat().st_size
    limit_s = LEAST_LIMIT_S + SECONDS_PER_BYTE * size
    limit_bytes = LEAST_LIMIT_BYTES + EXPANSION * size
    try:
        done = subprocess.run(
            [sys.executable, "-P", str(READER), str(path), str(target), str(limit_bytes)],
            capture_output=True, text=True, errors="replace", timeout=limit_s,
            env=os.environ | ONE_THREAD)
    except subprocess.TimeoutExpired:
        raise ValueError(f"it is not read within {limit_s:.0f} s") from None
    if done.returncode < 0:
        raise ValueError("its reader crashes on it")
    if done.returncode > 0:
        raise ValueError(done.stderr)
    variables, names = json.loads(done.stdout)
    return variables, names
