# SPDX-License-Identifier: BSD-3-Clause
"""Arrays and pandas frames become recordings by the rules for tables in files."""

import numpy as np
import pytest

from piezo_recorder.reading.columns import parse_columns
from piezo_recorder.reading.memory import recording_of, recordings_in
from piezo_recorder.reading.reader import origin_of, read_recording
from piezo_recorder.reading.recording import RecordingError

TIME_S = 0.01 * np.arange(200)
VOLTAGE_V = 50.0 - 50.0 * np.cos(2.0 * np.pi * TIME_S)
DISPLACEMENT_UM = 0.4 * VOLTAGE_V + 1.0
ARRAYS = {"time_s": TIME_S, "voltage_v": VOLTAGE_V, "displacement_um": DISPLACEMENT_UM}


def test_arrays_are_the_same_recording_as_their_file(tmp_path):
    path = tmp_path / "mine.csv"
    rows = zip(*(values.tolist() for values in ARRAYS.values()), strict=True)
    path.write_text(",".join(ARRAYS) + "\n" + "".join(
        ",".join(map(repr, row)) + "\n" for row in rows))
    of_file, of_arrays = read_recording(path), recording_of(ARRAYS)
    for name in ("sample_index", "sample_periods_s", "voltage_v", "displacement_um", "flags"):
        np.testing.assert_array_equal(getattr(of_arrays, name), getattr(of_file, name))
    assert origin_of(of_file)["sha256"] != origin_of(of_arrays)["sha256"]


def test_units_labels_and_further_columns_are_those_of_tables():
    recording = recording_of(
        {"t/ms": 1e3 * TIME_S, "monitor [V]": VOLTAGE_V / 20.0, "pos_nm": 1e3 * DISPLACEMENT_UM,
         "temperature": np.full(200, 21.5)}, parse_columns(["voltage=monitor[20V]"]))
    np.testing.assert_allclose(recording.voltage_v, VOLTAGE_V, atol=1e-12)
    np.testing.assert_allclose(recording.displacement_um, DISPLACEMENT_UM)
    assert recording.sample_period_s == pytest.approx(0.01)
    np.testing.assert_array_equal(recording.columns["temperature"], 21.5)


def test_rate_replaces_a_time():
    recording = recording_of({"u": VOLTAGE_V, "y_um": DISPLACEMENT_UM},
                             parse_columns(["rate=2[kHz]"]))
    assert recording.sample_period_s == pytest.approx(5e-4)


def test_hash_tells_other_samples():
    same, other = recording_of(ARRAYS), recording_of({**ARRAYS, "voltage_v": VOLTAGE_V + 1e-9})
    assert origin_of(same) == origin_of(recording_of(ARRAYS))
    assert origin_of(same)["sha256"] != origin_of(other)["sha256"]


def test_several_recordings_are_told_apart_by_a_time_that_begins_anew():
    twice = {name: np.tile(values, 2) for name, values in ARRAYS.items()}
    assert [len(each.voltage_v) for each in recordings_in(twice)] == [200, 200]
    with pytest.raises(RecordingError, match="holds 2 recordings"):
        recording_of(twice)


@pytest.mark.parametrize(("data", "objection"), [
    ({**ARRAYS, "voltage_v": VOLTAGE_V[:-1]}, "different numbers of values .*'voltage_v' 199"),
    ({**ARRAYS, "voltage_v": np.full(200, np.inf)}, "'inf', no finite number"),
    ({"time_s": TIME_S, "voltage_v": VOLTAGE_V}, "displacement"),
    ({"words": ["a", "b"]}, "holds no columns of numbers"),
    (VOLTAGE_V, "a ndarray is no recording"),
])
def test_what_cannot_be_a_recording_is_refused_in_one_line(data, objection):
    with pytest.raises(RecordingError, match=objection) as refused:
        recording_of(data)
    assert "\n" not in str(refused.value)


def test_frame_with_its_time_as_index():
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame(
        {"voltage_v": VOLTAGE_V, "displacement_um": DISPLACEMENT_UM},
        index=pandas.to_datetime("2026-03-01") + pandas.to_timedelta(TIME_S, unit="s"))
    recording = recording_of(frame)
    np.testing.assert_allclose(recording.time_s, TIME_S, atol=1e-9)
    np.testing.assert_array_equal(recording.voltage_v, VOLTAGE_V)


def test_frame_with_its_time_as_column():
    pandas = pytest.importorskip("pandas")
    np.testing.assert_array_equal(
        recording_of(pandas.DataFrame(ARRAYS)).displacement_um, DISPLACEMENT_UM)


def test_frame_of_a_recording_becomes_it_again():
    pytest.importorskip("pandas")
    recording = recording_of(ARRAYS)
    flags = np.where(np.arange(200) < 50, 24, 16).astype(np.uint32)
    object.__setattr__(recording, "flags", flags)
    again = recording_of(recording.to_frame())
    np.testing.assert_array_equal(again.flags, flags)
    np.testing.assert_array_equal(again.playing, recording.playing)
    assert again.columns == {}
