# SPDX-License-Identifier: BSD-3-Clause
"""Text of other programs is read to the numbers that were written, or refused in one line."""

import numpy as np
import pandas
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from piezo_recorder.reading.columns import parse_columns
from piezo_recorder.reading.reader import read_recording, read_recordings
from piezo_recorder.reading.recording import RecordingError

ROWS = 40
TIME_S = 1e-3 * np.arange(ROWS)
VOLTAGE_V = np.round(50.0 - 50.0 * np.cos(np.arange(ROWS) / 5.0), 4)
DISPLACEMENT_UM = np.round(0.3 * VOLTAGE_V + 0.1 * np.sin(np.arange(ROWS)), 5)
LABELS = [
    (("Time [s]", 1.0), ("t/ms", 1e3), ("time_us", 1e6), ("Zeit (s)", 1.0), ("Time ms", 1e3)),
    (("Voltage [V]", 1.0), ("U (mV)", 1e3), ("voltage_kv", 1e-3), ("Spannung in V", 1.0)),
    (("Position [nm]", 1e3), ("Weg [µm]", 1.0), ("displacement_mm", 1e-3), ("x/nm", 1e3)),
]
PREAMBLES = ["", "Messung 17\n", "Model,MSO44\nWaveform Type,ANALOG\nRecord Length,40\n\n",
             "# made by hand\n# on a Friday\n", "sep=;\n"]


@st.composite
def files(draw):
    """Draw one table as some program would write it."""
    delimiter, decimal = draw(st.sampled_from(
        [(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), ("  ", "."), ("|", ".")]))
    chosen = [draw(st.sampled_from(labels)) for labels in LABELS]
    encoding = draw(st.sampled_from(["utf-8", "utf-8-sig", "cp1252", "utf-16"]))
    ending = draw(st.sampled_from(["\n", "\r\n"]))
    start_s = draw(st.sampled_from([0.0, -1.0, 500.0]))
    order = draw(st.permutations(range(3)))
    columns = [scale * values for (_, scale), values in zip(
        chosen, (TIME_S + start_s, VOLTAGE_V, DISPLACEMENT_UM), strict=True)]
    lines = [delimiter.join(f"{columns[k][row]:.9g}".replace(".", decimal) for k in order)
             for row in range(ROWS)]
    for at in draw(st.lists(st.integers(1, ROWS - 1), max_size=3)):
        lines.insert(at, draw(st.sampled_from(["", "# a remark, in between", "% another; one"])))
    comment = draw(st.sampled_from(["", "# "]))
    header = comment + delimiter.join(chosen[k][0] for k in order)
    text = draw(st.sampled_from(PREAMBLES)) + "\n".join([header, *lines]) + "\n"
    return text.replace("\n", ending).encode(encoding)


@settings(deadline=None, max_examples=60)
@given(content=files())
def test_table_of_any_dialect_is_read_to_the_numbers_that_were_written(tmp_path_factory, content):
    path = tmp_path_factory.getbasetemp() / "dialect.txt"
    path.write_bytes(content)
    recording = read_recording(path)
    assert recording.sample_period_s == pytest.approx(1e-3, rel=1e-6)
    np.testing.assert_allclose(recording.voltage_v, VOLTAGE_V, atol=1e-6)
    np.testing.assert_allclose(recording.displacement_um, DISPLACEMENT_UM, atol=1e-6)
    assert recording.time_s[0] == 0.0
    assert recording.gaps == []
    assert recording.notes == []


def write(tmp_path, text, name="data.csv"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def rows(delimiter=",", scales=(1.0, 1.0, 1.0)):
    return "".join(delimiter.join(f"{scale * value:.9g}" for scale, value in zip(
        scales, row, strict=True)) + "\n"
        for row in zip(TIME_S, VOLTAGE_V, DISPLACEMENT_UM, strict=True))


@pytest.mark.parametrize("header", [
    "# ms\tV\tum\n", "ms\tV\tnm\n", "[ms]\t[V]\t[um]\n", "s\tV\tµm\n"])
def test_units_alone_tell_the_columns(tmp_path, header):
    time, way = 1e3 if "ms" in header else 1.0, 1e3 if "nm" in header else 1.0
    recording = read_recording(write(tmp_path, header + rows("\t", (time, 1.0, way))))
    assert recording.notes == []
    assert recording.sample_period_s == pytest.approx(1e-3)
    np.testing.assert_allclose(recording.voltage_v, VOLTAGE_V)
    np.testing.assert_allclose(recording.displacement_um, DISPLACEMENT_UM)


@pytest.mark.parametrize("write_frame", [
    lambda frame, path: frame.to_csv(path),
    lambda frame, path: frame.to_csv(path, index=False, sep=";", decimal=","),
    lambda frame, path: frame.assign(temperature_c=[20.0, *[None] * (ROWS - 1)], by="me").to_csv(
        path, index=False),
    lambda frame, path: frame.assign(**{"time [s]": pandas.date_range(
        "2026-03-01 23:59:59.990", periods=ROWS, freq="ms")}).to_csv(path, index=False),
])
def test_what_pandas_writes_is_read(tmp_path, write_frame):
    path = tmp_path / "frame.csv"
    write_frame(pandas.DataFrame({"time [s]": TIME_S, "voltage [V]": VOLTAGE_V,
                                  "position [um]": DISPLACEMENT_UM}), path)
    recording = read_recording(path)
    np.testing.assert_allclose(recording.voltage_v, VOLTAGE_V)
    np.testing.assert_allclose(recording.displacement_um, DISPLACEMENT_UM)
    assert recording.sample_period_s == pytest.approx(1e-3)


@pytest.mark.parametrize("delimiter", [" ", ","])
def test_what_numpy_writes_is_read(tmp_path, delimiter):
    path = tmp_path / "saved.txt"
    np.savetxt(path, np.column_stack([TIME_S, VOLTAGE_V, DISPLACEMENT_UM]), delimiter=delimiter,
               header=delimiter.join(["time_s", "voltage_v", "displacement_um"]))
    np.testing.assert_allclose(read_recording(path).voltage_v, VOLTAGE_V)


SCOPES = {
    "tektronix": "Model,MSO44\nWaveform Type,ANALOG\nSample Interval,0.001\n,,\nLabels,,\n"
                 "TIME,CH1,CH2\n",
    "keysight": "x-axis,CH1,CH2\nsecond,Volt,Volt\n",
    "picoscope": "Time,CH1,CH2\n(s),(V),(V)\n\n",
}


@pytest.mark.parametrize("scope", SCOPES)
def test_an_oscilloscope_with_a_preamble_is_read_once_its_channels_are_told(tmp_path, scope):
    path = write(tmp_path, SCOPES[scope] + rows(scales=(1.0, 1 / 20.0, 1 / 5.0)))
    with pytest.raises(RecordingError, match="CH1.*say which"):
        read_recording(path)
    time = "x-axis" if scope == "keysight" else "Time"
    recording = read_recording(path, columns=parse_columns(
        [f"time={time}", "voltage=CH1[20V]", "displacement=CH2[5um/V]"]))
    np.testing.assert_allclose(recording.voltage_v, VOLTAGE_V, atol=1e-6)
    np.testing.assert_allclose(recording.displacement_um, DISPLACEMENT_UM, atol=1e-6)


def test_columns_without_a_header_are_named_by_number_or_lie_told_beside(tmp_path):
    path = write(tmp_path, rows(" ", (1e3, 1.0, 1e3)))
    with pytest.raises(RecordingError, match="--columns time=NAME"):
        read_recording(path)
    told = ["time=1[ms]", "voltage=2[V]", "displacement=3[nm]"]
    for_option = read_recording(path, columns=parse_columns(told))
    (tmp_path / "data.columns.yaml").write_text(
        'time: {column: "1", unit: ms}\nvoltage: {column: "2", unit: V}\n'
        'displacement: {column: "3", unit: um, factor: 0.001}\n')
    for recording in (for_option, read_recording(path)):
        np.testing.assert_allclose(recording.displacement_um, DISPLACEMENT_UM, atol=1e-6)
        assert recording.sample_period_s == pytest.approx(1e-3)


def test_rate_replaces_a_time(tmp_path):
    path = write(tmp_path, "U [V];x [um]\n" + "".join(
        f"{volt};{um}\n" for volt, um in zip(VOLTAGE_V, DISPLACEMENT_UM, strict=True)))
    with pytest.raises(RecordingError, match=r"rate=10\[kHz\]"):
        read_recording(path)
    recording = read_recording(path, columns=parse_columns(["rate=4[kHz]"]))
    assert recording.sample_period_s == pytest.approx(250e-6)


@pytest.mark.parametrize("text, options", [
    ("run;t [s];U [V];x [um]\n" + "".join(
        f"{run};{t};{t * run};{2 * t}\n" for run in (1, 2) for t in range(30)),
     ["recording=run"]),
    ("t [s];U [V];x [um]\n" + "".join(
        f"{t};{t * run};{2 * t}\n" for run in (1, 2) for t in range(30)), []),
    ("".join(["t [s];U [V];x [um]\n" + "".join(
        f"{t + 7};{t * run};{2 * t}\n" for t in range(30)) for run in (1, 2)]), []),
])
def test_several_recordings_of_one_table_are_told_apart(tmp_path, text, options):
    path = write(tmp_path, text)
    first, second = read_recordings(path, columns=parse_columns(options))
    assert (first.title, second.title) == ("1", "2")
    np.testing.assert_array_equal(second.voltage_v, 2.0 * first.voltage_v)
    with pytest.raises(RecordingError, match=r"holds 2 recordings \(1, 2\): choose one"):
        read_recording(path, columns=parse_columns(options))
    chosen = options[0] + "[2]" if options else "recording=[2]"
    assert read_recording(path, columns=parse_columns([chosen])).voltage_v[-1] == 58.0
    with pytest.raises(RecordingError, match="no recording '3': give one of 1, 2"):
        read_recording(path, columns=parse_columns([chosen.replace("2", "3")]))


@pytest.mark.parametrize("text, said", [
    ("t [s];U [V];x\n" + rows(";"), "'x' has no unit.*displacement=x"),
    ("Command [V],Drive [V],t [s],x [um]\n" + "0,1,0,2\n1,1,1,2\n", "may each be the voltage"),
    ("a,b,c\n" + rows(), "the column time_s is missing.*'a', 'b', 'c'"),
    ("time_s,voltage_v,displacement_um\n0,1,5,2\n1,1,5,2\n", "row 2: 4 values where.* 3"),
    ("nothing but words\nand words\n", "row 1: no table of numbers"),
    ("\0\1\2 binary", "not plain text"),
    ("SQLite format 3\0", "ros2 bag convert"),
    ("time_s,voltage_v,displacement_um\n0,1,2\n1,1,2\n2,1,2\n3,1,2\n1e300,1,2\n",
     "steps by 1e\\+300 s"),
])
def test_what_cannot_be_read_is_refused_in_one_line_that_names_the_cure(tmp_path, text, said):
    path = write(tmp_path, text)
    with pytest.raises(RecordingError, match=said) as refusal:
        read_recording(path)
    assert "\n" not in str(refusal.value)
    assert str(refusal.value).startswith(str(path))


@pytest.mark.parametrize("options, said", [
    (["time"], "has 'time': give words such as"),
    (["volts=U[V]"], "has 'volts=U"),
    (["rate=fast"], "rate=fast"),
    (["rate=10[m]"], "rate=10"),
    (["voltage=[V]"], "names no column for the voltage"),
    (["displacement=x[furlong]"], "'furlong' is no unit of the displacement"),
    (["voltage=nothing[V]"], "no column 'nothing' for the voltage"),
    (["time=U[s]", "voltage=U[V]"], "cannot be the time and another|cannot be the voltage"),
])
def test_wrong_words_for_columns_are_refused_with_what_to_give(tmp_path, options, said):
    path = write(tmp_path, "t [s];U [V];x [um]\n" + rows(";"))
    with pytest.raises(RecordingError, match=said):
        read_recording(path, columns=parse_columns(options))


def test_wrong_yaml_beside_the_data_is_named(tmp_path):
    path = write(tmp_path, "t [s];U [V];x [um]\n" + rows(";"))
    (tmp_path / "columns.yaml").write_text("time: {column: 1}\n")
    with pytest.raises(RecordingError, match="columns.yaml: time.column is not a text"):
        read_recording(path)


def test_rows_are_counted_in_the_file_also_behind_comments_and_in_later_parts(
        tmp_path, monkeypatch):
    monkeypatch.setattr("piezo_recorder.reading.tables.delimited_text.CHUNK_LINES", 7)
    lines = ["# one", "time_s,voltage_v,displacement_um", *(f"{k},0,{k}" for k in range(30))]
    lines.insert(10, "# two")
    lines[25] = "22,0,broken"
    with pytest.raises(RecordingError, match="row 26: displacement_um is 'broken'"):
        read_recording(write(tmp_path, "\n".join(lines)))
    lines[25] = "3,0,3"
    with pytest.raises(RecordingError, match="row 26: time_s steps by"):
        read_recording(write(tmp_path, "\n".join(lines)))


def test_large_file_is_read_in_parts_with_progress(tmp_path, monkeypatch):
    monkeypatch.setattr("piezo_recorder.reading.tables.delimited_text.CHUNK_LINES", 1000)
    index = np.arange(20_000)
    path = tmp_path / "large.csv"
    np.savetxt(path, np.column_stack([1e-3 * index, index % 7, index]), delimiter=";", fmt="%.6g",
               header="t [s];U [V];x [um]", comments="")
    told = []
    recording = read_recording(path, progress=lambda what, fraction: told.append(fraction))
    np.testing.assert_array_equal(recording.displacement_um, index)
    assert len(told) == 20
    assert told == sorted(told) and told[-1] == 1.0
