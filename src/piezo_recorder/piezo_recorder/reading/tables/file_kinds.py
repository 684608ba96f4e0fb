# SPDX-License-Identifier: BSD-3-Clause
"""Recognition of a file's kind by its first bytes, regardless of its name."""

from collections.abc import Callable
from pathlib import Path

from piezo_recorder.reading.recording import RecordingError
from piezo_recorder.reading.tables.array_files import read_hdf5, read_npy, read_wav
from piezo_recorder.reading.tables.columnar_files import read_arrow, read_parquet, read_tdms
from piezo_recorder.reading.tables.delimited_text import Needed, read_text_table
from piezo_recorder.reading.tables.matlab_files import is_version_4, read_matlab
from piezo_recorder.reading.tables.table import Progress, Table
from piezo_recorder.reading.tables.workbooks import read_zip

TableReader = Callable[[Path, Progress], list[Table]]

HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
READERS: tuple[tuple[bytes, TableReader], ...] = (
    (HDF5_MAGIC, read_hdf5), (b"\x93NUMPY", read_npy), (b"PK\x03\x04", read_zip),
    (b"MATLAB 5.0", read_matlab), (b"TDSm", read_tdms), (b"PAR1", read_parquet),
    (b"ARROW1", read_arrow), (b"RIFF", read_wav))
"""Readers by the first bytes of a file."""

FOREIGN = {
    b"SQLite format 3": ("a recording of rosbag2 as sqlite3",
                         "convert it with `ros2 bag convert` to uncompressed mcap"),
    b"\x1f\x8b": ("compressed by gzip", "unpack it with gunzip"),
    b"BZh": ("compressed by bzip2", "unpack it"),
    b"\xd0\xcf\x11\xe0": ("an old workbook of a spreadsheet program",
                            "save it as .xlsx, or the sheet as CSV"),
    b"%PDF": ("a PDF", "give the data"),
}
"""Known kinds that cannot be read, with their description and what to do."""

MATLAB_HDF5_OFFSET = 512


def read_tables(path: Path, needed: Needed, progress: Progress) -> list[Table]:
    """Read the tables of a file; groups have a table each, followed by one of all together.

    RecordingError is raised if the kind of the file is unknown, or it is damaged.
    """
    with open(path, "rb") as file:
        head = file.read(MATLAB_HDF5_OFFSET + len(HDF5_MAGIC))
    if head[MATLAB_HDF5_OFFSET:] == HDF5_MAGIC:
        return read_hdf5(path, progress)
    if is_version_4(head):
        return read_matlab(path, progress)
    for magic, read in READERS:
        if head.startswith(magic):
            return read(path, progress)
    for magic, (what, cure) in FOREIGN.items():
        if head.startswith(magic):
            raise RecordingError(f"{path} is {what}: {cure}")
    return [read_text_table(path, needed, progress)]
