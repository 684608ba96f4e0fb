# SPDX-License-Identifier: BSD-3-Clause
"""Reader of CSV files with our columns; `table_reader` reads them as it reads any other table."""

from pathlib import Path

from piezo_recorder.reading.recording import Recording, RecordingError
from piezo_recorder.reading.table_reader import read_table_recordings

CSV_COLUMNS = ("time_s", "voltage_v", "displacement_um")


def read_csv(path: Path) -> Recording:
    """Read a text file that holds one recording; see `read_table_recordings`."""
    recordings = read_table_recordings(path)
    if len(recordings) > 1:
        raise RecordingError(f"{path} holds {len(recordings)} recordings: read them with "
                             "read_recordings")
    return recordings[0]
