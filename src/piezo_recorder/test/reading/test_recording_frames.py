# SPDX-License-Identifier: BSD-3-Clause
"""A recording opens as a pandas frame in one call; without pandas it says what to do."""

import sys

import numpy as np
import pytest

from piezo_recorder.reading.frames import read_frame
from piezo_recorder.reading.recording import RecordingError

CSV = "time_s,voltage_v,displacement_um,temperature_c\n0,1,10,20\n0.5,2,11,21\n1,3,12,22\n"


@pytest.fixture
def recording(tmp_path):
    path = tmp_path / "recording.csv"
    path.write_text(CSV)
    return path


def test_frame_holds_every_column_under_the_time(recording):
    frame = read_frame(recording)
    assert frame.index.name == "time_s"
    np.testing.assert_allclose(frame.index, [0.0, 0.5, 1.0])
    np.testing.assert_array_equal(frame["voltage_v"], [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(frame["displacement_um"], [10.0, 11.0, 12.0])
    np.testing.assert_array_equal(frame["temperature_c"], [20.0, 21.0, 22.0])
    np.testing.assert_array_equal(frame["sample_index"], [0, 1, 2])


def test_missing_pandas_is_said_with_the_cure(recording, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(RecordingError, match="pandas is not installed: install it"):
        read_frame(recording)
