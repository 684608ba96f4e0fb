# SPDX-License-Identifier: BSD-3-Clause
import hashlib

import pytest

from piezo_recorder.reading.reader import read_recording, sha256_of
from piezo_recorder.reading.recording import RecordingError

HEADER = "time_s,voltage_v,displacement_um"


def write(tmp_path, text):
    path = tmp_path / "data.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_columns_are_read_by_name_and_further_ones_are_kept(tmp_path):
    path = write(tmp_path, "voltage_v, temperature_k ,time_s,displacement_um\n"
                           "1,300,5.0,10\n2,301,5.1,11\n3,302,5.2,12\n")
    recording = read_recording(path)
    assert recording.voltage_v.tolist() == [1, 2, 3]
    assert recording.displacement_um.tolist() == [10, 11, 12]
    assert list(recording.columns) == ["temperature_k"]
    assert recording.columns["temperature_k"].tolist() == [300, 301, 302]
    assert recording.sample_period_s == pytest.approx(0.1)
    assert recording.time_s == pytest.approx([0, 0.1, 0.2])
    assert recording.sample_index.tolist() == [0, 1, 2]
    assert recording.playing.all()
    assert recording.gaps == []
    assert recording.select(recording.voltage_v > 1).columns["temperature_k"].tolist() \
        == [301, 302]
    assert sha256_of(path) == hashlib.sha256(path.read_bytes()).hexdigest()


def test_times_rounded_in_print_are_uniform(tmp_path):
    rows = "".join(f"{n / 3000:.6f},0,0\n" for n in range(3000))
    recording = read_recording(write(tmp_path, f"{HEADER}\n{rows}"))
    assert recording.sample_period_s == pytest.approx(1 / 3000, rel=1e-5)


def test_a_byte_order_mark_and_a_last_empty_line_do_no_harm(tmp_path):
    recording = read_recording(write(tmp_path, f"\ufeff{HEADER}\r\n0,1,2\r\n1,3,4\r\n\r\n"))
    assert recording.voltage_v.tolist() == [1, 3]


@pytest.mark.parametrize(("text", "where", "what"), [
    ("", "row 1", "no table of numbers begins"),
    ("time_s,voltage_v\n0,1\n1,2\n", "row 1", "the column displacement_um is missing"),
    (f"{HEADER},voltage_v\n0,1,2,3\n1,1,2,3\n", "row 1", "'voltage_v.1', 'voltage_v.2' may"),
    (f"{HEADER}\n0,1,2\n1,nan,2\n2,1,2\n", "row 3", "voltage_v is missing"),
    (f"{HEADER}\n0,1,2\n1,1,inf\n2,1,2\n", "row 3", "displacement_um is 'inf'"),
    (f"{HEADER}\n0,1,2\n1,1,2\n2,1,two\n", "row 4", "displacement_um is 'two'"),
    (f"{HEADER}\n0,1,2\n1,,2\n2,1,2\n", "row 3", "voltage_v is missing"),
    (f"{HEADER}\n0,1,2\n1,1\n2,1,2\n", "row 3", "2 values where the header names 3"),
    (f"{HEADER}\n0,1,2,9\n1,1,2,9\n", "row 2", "4 values where the header names 3"),
    (f"{HEADER}\n0,1,2\n1,1,2\n2,1,2\n1,1,2\n2,1,2\n", "row 5", "time_s steps by -1 s"),
    (f"{HEADER}\n0,1,2\n0,1,2\n0,1,2\n", "row 3", "time_s steps by 0 s"),
])
def test_a_faulty_file_is_refused_with_its_row_and_a_cure(tmp_path, text, where, what):
    path = write(tmp_path, text)
    with pytest.raises(RecordingError) as caught:
        read_recording(path)
    message = str(caught.value)
    assert message.startswith(f"{path}, {where}: ")
    assert what in message
    assert message.count(": ") >= 2
    assert "\n" not in message


@pytest.mark.parametrize("rows", ["", "0,1,2\n"])
def test_too_few_rows_are_refused(tmp_path, rows):
    with pytest.raises(RecordingError, match="fewer than two rows"):
        read_recording(write(tmp_path, f"{HEADER}\n{rows}"))
