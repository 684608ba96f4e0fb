# SPDX-License-Identifier: BSD-3-Clause
"""A voltage to play comes from a table as it stands there, or is refused in one line."""

import csv
import os

import pytest

from piezo_recorder.reading.waveform_file import read_waveform


def write(path, header, rows):
    with open(path, "w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([header, *rows])
    return path


@pytest.mark.parametrize("period_s", [25e-6, 0.001, 1.0])
def test_voltage_and_period_are_those_of_the_table(tmp_path, period_s):
    rows = [(f"{2.0 + k * period_s:.9f}", 0.5 * k, "any") for k in range(7)]
    path = write(tmp_path / "mine.csv", ("time_s", "voltage_v", "displacement_um"), rows)
    voltage_v, sample_period_s, axes, marks = read_waveform(path)
    assert voltage_v.tolist() == [0.5 * k for k in range(7)]
    assert sample_period_s == pytest.approx(period_s, rel=1e-9)
    assert axes == () and not marks.size


def test_voltages_of_several_axes_are_the_columns_of_an_array(tmp_path):
    rows = [(0.001 * k, 0.5 * k, -k, k % 2, "any") for k in range(7)]
    path = write(tmp_path / "both.csv", ("time_s", "x_voltage_v", "y_voltage_v", "line", "note"),
                 rows)
    voltage_v, sample_period_s, axes, marks = read_waveform(path)
    assert axes == ("x", "y") and sample_period_s == 0.001
    assert marks.tolist() == [0, 2, 0, 2, 0, 2, 0]
    assert voltage_v.tolist() == [[0.5 * k, -k] for k in range(7)]


@pytest.mark.parametrize("text", ["", '{"format": 1}', "\\x89PNG", "t [ms];U [V]\n0;1\n1;2\n"])
def test_a_file_that_is_no_table_is_refused_in_one_line(tmp_path, text):
    path = tmp_path / "mine.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match="mine.csv .*give a CSV file with the columns") as refused:
        read_waveform(path)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(("header", "rows", "said"), [
    (("time_s", "volts"), [(0, 1), (1, 2)], "has no column voltage_v"),
    (("t", "voltage_v"), [(0, 1), (1, 2)], "has no column time_s"),
    (("time_s", "voltage_v"), [(0, 1)], "needs two rows or more"),
    (("time_s", "voltage_v"), [(0, 1), (1, "nan"), (2, 1)], "a number in each field"),
    (("time_s", "voltage_v"), [(0, 1), (1, 2), (3, 1)], "not sampled uniformly"),
    (("time_s", "voltage_v"), [(2, 1), (1, 2), (0, 1)], "not sampled uniformly"),
    (("time_s", "voltage_v"), [(0, 1), (1, 2, 3)], "is no table of numbers"),
])
def test_table_that_cannot_be_played_is_refused_in_one_line(tmp_path, header, rows, said):
    path = write(tmp_path / "mine.csv", header, rows)
    with pytest.raises(ValueError, match=said) as refused:
        read_waveform(path)
    assert "\n" not in str(refused.value)


def test_what_is_no_file_of_a_bounded_size_is_refused_without_being_read(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with open(tmp_path / "sparse", "wb") as sparse:
        sparse.truncate(3 * 2**30)
    for path, said in (("/dev/zero", "is a device"), (tmp_path / "pipe", "is a pipe"),
                       (tmp_path / "sparse", "more than the"), (tmp_path, "is a directory"),
                       (tmp_path / "none", "No such file")):
        with pytest.raises(ValueError, match=said):
            read_waveform(path)
