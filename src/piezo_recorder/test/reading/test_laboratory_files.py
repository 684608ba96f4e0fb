# SPDX-License-Identifier: BSD-3-Clause
"""Habits of laboratories and of their programs are read to the numbers, or asked about."""

import wave
from datetime import datetime, timedelta, timezone

import numpy as np
import pytest
import scipy.io

from piezo_recorder.reading.columns import parse_columns
from piezo_recorder.reading.reader import read_recording, read_recordings
from piezo_recorder.reading.recording import RecordingError

ROWS = 200
TIME_S = 1e-3 * np.arange(ROWS)
VOLTAGE_V = np.round(50.0 - 50.0 * np.cos(np.arange(ROWS) / 16.0), 4)
DISPLACEMENT_UM = np.round(0.3 * VOLTAGE_V + 2.0 * np.sin(np.arange(ROWS) / 16.0), 5)
LABELS = "Time [s];Voltage [V];Position [um]\n"


def table(form, *columns):
    return "".join(form.format(*row) + "\n" for row in zip(*columns, strict=True))


def rows(time_s=TIME_S, at=slice(None)):
    return table("{:.4f};{:.4f};{:.5f}", time_s[at], VOLTAGE_V[at], DISPLACEMENT_UM[at])


def write(tmp_path, text, name="data.csv"):
    path = tmp_path / name
    path.write_bytes(text.encode("utf-8"))
    return path


def thousands(value, swap=False):
    text = f"{value:,.1f}"
    return text.translate(str.maketrans(",.", ".,")) if swap else text


LABVIEW = (
    "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDecimal_Separator\t.\n"
    "Multi_Headings\tYes\nX_Columns\t{columns}\nTime\t12:00:01.5\n***End_of_Header***\t\n"
    "\t\nChannels\t2\t\t\nSamples\t200\t200\t\nDate\t2026/03/01\t2026/03/01\t\n"
    "Y_Unit_Label\tV\tum\t\nX_Dimension\tTime\tTime\t\nX0\t0.0\t0.0\t\n"
    "Delta_X\t0.001\t0.001\t\n***End_of_Header***\t\t\t\n"
    "X_Value\tPiezo voltage\tPosition\tComment\n")
METADATA = "".join(
    [f"Channel {k} gain,{1.5 * k}\n" for k in range(12)]
    + [f"Calibration {k},{k},{2 * k}\n" for k in range(12)]
    + ["Date,2026-03-01,12:00:05\n", "Sample rate,1000,Hz\n", "Remark: a, b, c\n", "\n", "\n"])
BEFORE_MIDNIGHT = [datetime(2026, 3, 1, 23, 59, 59, 900_000) + timedelta(milliseconds=k)
                   for k in range(ROWS)]

READ = {
    "thousands of a spreadsheet": "\ufeffTime (s),Piezo voltage (mV),Position (nm)\r\n" + "".join(
        f'{t:.3f},"{thousands(1e3 * u)}","{thousands(1e3 * y)}"\r\n'
        for t, u, y in zip(TIME_S, VOLTAGE_V, DISPLACEMENT_UM, strict=True)),
    "thousands of a German spreadsheet": "Zeit [s];Spannung [mV];Weg [nm]\n" + "".join(
        f"{t:.3f};".replace(".", ",") + f"{thousands(1e3 * u, True)};{thousands(1e3 * y, True)}\n"
        for t, u, y in zip(TIME_S, VOLTAGE_V, DISPLACEMENT_UM, strict=True)),
    "thirty lines of metadata, names and units": METADATA + "Time,Voltage,Position\ns,V,µm\n"
        + rows().replace(";", ","),
    "LabVIEW": LABVIEW.format(columns="One") + rows().replace(";", "\t"),
    "LabVIEW without times": LABVIEW.format(columns="No") + table(
        "\t{:.4f}\t{:.5f}", VOLTAGE_V, DISPLACEMENT_UM),
    "timestamps with a zone": "timestamp;voltage [V];position [um]\n" + table(
        "{};{:.4f};{:.5f}",
        [time.replace(tzinfo=timezone(timedelta(hours=1))).isoformat(timespec="milliseconds")
         for time in BEFORE_MIDNIGHT], VOLTAGE_V, DISPLACEMENT_UM),
    "German dates": "Datum/Uhrzeit;Spannung [V];Weg [µm]\n" + table(
        "{};{:.4f};{:.5f}", [time.strftime("%d.%m.%Y %H:%M:%S.%f") for time in BEFORE_MIDNIGHT],
        VOLTAGE_V, DISPLACEMENT_UM),
    "American dates and times apart, over midnight":
        "Date;Time;Voltage [V];Position [um]\n" + table(
        "{};{:.4f};{:.5f}", [time.strftime("%m/%d/%Y;%I:%M:%S.%f %p") for time in BEFORE_MIDNIGHT],
        VOLTAGE_V, DISPLACEMENT_UM),
    "days of a spreadsheet": "Time [d];U [V];x [um]\n" + table(
        "{:.11f};{:.4f};{:.5f}", 46_082.5 + TIME_S / 86_400.0, VOLTAGE_V, DISPLACEMENT_UM),
    "Fortran": "time(s) voltage(V) pos(um)\n" + table(
        "{:.6E} {:.6E} {:.6E}", TIME_S, VOLTAGE_V, DISPLACEMENT_UM).replace("E", "D"),
    "words and a trigger beside":
        "Time [s];State;Trigger;Voltage [V];Position [micrometre]\n" + table(
        "{:.3f};{};{};{:.4f};{:.5f}", TIME_S, ["idle", "RUN"] * (ROWS // 2), [0, 1] * (ROWS // 2),
        VOLTAGE_V, DISPLACEMENT_UM),
}


def assert_true_numbers(recording, atol=1e-4):
    assert recording.sample_period_s == pytest.approx(1e-3, rel=1e-5)
    np.testing.assert_allclose(recording.voltage_v, VOLTAGE_V, atol=atol)
    np.testing.assert_allclose(recording.displacement_um, DISPLACEMENT_UM, atol=atol)
    assert recording.gaps == []


@pytest.mark.parametrize("habit", READ)
def test_file_of_a_habit_is_read_to_its_numbers(tmp_path, habit):
    assert_true_numbers(read_recording(write(tmp_path, READ[habit])))


def test_mark_before_three_digits_is_decimal_where_nothing_says_otherwise(tmp_path):
    text = "t [ms];U [V];x [um]\n" + "".join(
        f"{k};{1 + k % 9},{k % 1000:03};{k % 7},500\n" for k in range(100))
    recording = read_recording(write(tmp_path, text))
    assert recording.voltage_v[:3].tolist() == [1.0, 2.001, 3.002]
    assert recording.displacement_um.max() == 6.5
    # The times show that the point is the decimal mark.
    text = "t [s],U [mV],x [um]\n" + "".join(
        f'{k / 8},"{1 + k % 9},{k % 1000:03}",{k % 7}.5\n' for k in range(100))
    recording = read_recording(write(tmp_path, text))
    np.testing.assert_allclose(recording.voltage_v[:3], [1.0, 2.001, 3.002])
    assert any("'1,000' in row 2 is read as 1000" in note for note in recording.notes)


def test_rows_without_a_value_are_left_out_and_told(tmp_path):
    lines = rows().splitlines(keepends=True)
    for row, missing in ((50, "NaN"), (51, ""), (120, "9.91E+37")):
        lines[row] = lines[row].rpartition(";")[0] + f";{missing}\n"
    recording = read_recording(write(tmp_path, LABELS + "".join(lines)))
    known = np.delete(np.arange(ROWS), [50, 51, 120])
    np.testing.assert_allclose(recording.displacement_um[known], DISPLACEMENT_UM[known], atol=1e-9)
    np.testing.assert_allclose(recording.displacement_um, DISPLACEMENT_UM, atol=0.1)
    assert any("3 rows have no value, the first of them row 52" in note for note in recording.notes)


def test_long_part_without_a_value_is_a_gap_also_without_times(tmp_path):
    text = "U [V];x [um]\n" + "".join(
        f"{u:.4f};{'' if 60 <= row < 68 else y}\n"
        for row, (u, y) in enumerate(zip(VOLTAGE_V, DISPLACEMENT_UM, strict=True)))
    recording = read_recording(write(tmp_path, text), columns=parse_columns(["rate=1[kHz]"]))
    assert recording.gaps == [(60, 8)]
    np.testing.assert_array_equal(recording.voltage_v, np.delete(VOLTAGE_V, np.arange(60, 68)))


def test_column_that_is_mostly_empty_is_no_signal(tmp_path):
    text = LABELS + "".join(f"{t};{t};{'' if t % 3 else t}\n" for t in range(60))
    with pytest.raises(RecordingError, match="row 3: Position .* is missing.* in 40 of 60"):
        read_recording(write(tmp_path, text))


@pytest.mark.parametrize("footer, lines", [
    ("Mean;50.0;15.0\n", 1), ("\nMean;50.0;15.0\n# remark\nEnd of file\n\n", 4)])
def test_summary_below_the_rows_is_left_out_and_told(tmp_path, footer, lines):
    recording = read_recording(write(tmp_path, LABELS + rows() + footer))
    assert_true_numbers(recording)
    assert any(f"ends with {lines} lines that are no rows" in note for note in recording.notes)


def test_text_between_rows_is_no_footer(tmp_path):
    lines = rows().splitlines(keepends=True)
    text = LABELS + "".join(lines[:150]) + "Mean;50.0;15.0\n" + "".join(lines[150:])
    with pytest.raises(RecordingError, match="row 152: Time .* is 'Mean'"):
        read_recording(write(tmp_path, text))


def test_row_that_was_written_twice_counts_once_and_one_that_is_missing_is_put_in(tmp_path):
    at = np.sort(np.append(np.delete(np.arange(ROWS), 77), [100, 101, 150]))
    recording = read_recording(write(tmp_path, LABELS + rows(at=at)))
    assert recording.sample_period_s == pytest.approx(1e-3)
    known = np.delete(np.arange(ROWS), 77)
    np.testing.assert_allclose(recording.voltage_v[known], VOLTAGE_V[known], atol=1e-9)
    assert any("3 rows are there twice, the first of them row 102" in note
               for note in recording.notes)


def test_times_that_are_rounded_to_a_clock_slower_than_the_rows_lose_no_row(tmp_path):
    time_s = np.floor(4e-4 * np.arange(ROWS) * 1e3) / 1e3
    text = LABELS + table("{:.3f};{:.4f};{:.5f}", time_s, VOLTAGE_V, np.repeat([0.0, 30.0], 100))
    recording = read_recording(write(tmp_path, text))
    assert recording.sample_period_s == pytest.approx(4e-4, rel=5e-3)
    np.testing.assert_array_equal(recording.voltage_v, VOLTAGE_V)


def test_second_recording_may_begin_a_little_later_on_its_clock_and_have_another_rate(tmp_path):
    text = LABELS + rows() + rows(2.0 * TIME_S + 0.004)
    first, second = read_recordings(write(tmp_path, text))
    np.testing.assert_array_equal(first.voltage_v, second.voltage_v)
    assert first.sample_period_s == pytest.approx(1e-3)
    assert second.sample_period_s == pytest.approx(2e-3)


def test_label_that_is_there_twice_is_told_by_its_number(tmp_path):
    text = "Time [s];Voltage [V];Time [s];Position [um]\n" + table(
        "{:.4f};{:.4f};{:.4f};{:.5f}", TIME_S, VOLTAGE_V, TIME_S, DISPLACEMENT_UM)
    path = write(tmp_path, text)
    with pytest.raises(RecordingError, match=r"'Time \[s\].1', 'Time \[s\].2' may each be"):
        read_recording(path)
    assert_true_numbers(read_recording(path, columns=parse_columns(["time=1"])))


def test_remarks_beside_the_first_rows_cost_no_row(tmp_path):
    lines = table(",,,{:.4f},{:.4f},{:.5f}", TIME_S, VOLTAGE_V, DISPLACEMENT_UM).splitlines()
    for row, remark in enumerate(["Record Length,200,Points", "Sample Interval,1e-3,s"]):
        lines[row] = remark + lines[row][2:]
    path = write(tmp_path, "\n".join(lines) + "\n")
    assert_true_numbers(read_recording(path, columns=parse_columns(
        ["time=4[s]", "voltage=5[V]", "displacement=6[um]"])))


def test_counts_of_a_converter_are_scaled_by_a_factor(tmp_path):
    text = "n;time_us;AO0 [counts];AI0 [counts]\n" + table(
        "{};{:.0f};{};{}", np.arange(ROWS), 1e6 * TIME_S, np.round(VOLTAGE_V / 1.5e-3).astype(int),
        np.round(DISPLACEMENT_UM / 5e-4).astype(int))
    recording = read_recording(write(tmp_path, text), columns=parse_columns(
        ["time=time_us[us]", "voltage=AO0[1.5mV]", "displacement=AI0[0.5nm]"]))
    assert_true_numbers(recording, atol=1e-3)


def test_sound_card_is_read_in_counts_at_its_rate(tmp_path):
    path = tmp_path / "card.wav"
    with wave.open(str(path), "wb") as file:
        file.setnchannels(2)
        file.setsampwidth(2)
        file.setframerate(48_000)
        file.writeframes(np.column_stack([200 * VOLTAGE_V, 500 * DISPLACEMENT_UM]).astype(
            "<i2").tobytes())
    recording = read_recording(path, columns=parse_columns(
        ["voltage=channel.1[5mV]", "displacement=channel.2[2nm]"]))
    assert recording.sample_period_s == pytest.approx(1.0 / 48_000.0)
    np.testing.assert_allclose(recording.voltage_v, VOLTAGE_V, atol=6e-3)
    np.testing.assert_allclose(recording.displacement_um, DISPLACEMENT_UM, atol=3e-3)


@pytest.mark.usefixtures("matlab_in_place")
def test_matlab_array_of_structures_with_a_sample_each_is_read_as_columns(tmp_path):
    log = np.zeros(ROWS, dtype=[("t", float), ("V", float), ("x_um", float)])
    log["t"], log["V"], log["x_um"] = TIME_S, VOLTAGE_V, DISPLACEMENT_UM
    scipy.io.savemat(tmp_path / "log.mat", {"log": log})
    assert_true_numbers(read_recording(tmp_path / "log.mat"))


@pytest.mark.parametrize("text, said", [
    ("Time,Voltage,Position\n" + table("{:.4f} s,{:.4f} V,{:.5f} um", TIME_S, VOLTAGE_V, TIME_S),
     "row 2: '0.0000 s' is no number: write the units into the header"),
    (LABELS + rows() + "0.2;1;OVLD\n0.201;1;1\n", "is 'OVLD', no finite number"),
])
def test_what_is_no_number_is_told_with_its_cure(tmp_path, text, said):
    with pytest.raises(RecordingError, match=said):
        read_recording(write(tmp_path, text))


def test_days_without_a_unit_are_implausible(tmp_path):
    text = "Time;U [V];x [um]\n" + table(
        "{:.11f};{:.4f};{:.5f}", 46_082.5 + TIME_S / 86_400.0, VOLTAGE_V, DISPLACEMENT_UM)
    recording = read_recording(write(tmp_path, text))
    assert any("is the time in days" in note for note in recording.notes)


def test_names_units_and_channels_above_the_rows_are_told_apart(tmp_path):
    rows = "".join(f"{0.5 * n:.1f},{v:.3f},{-120.0 * v:.2f}\n"
                   for n, v in enumerate(50.0 - 50.0 * np.cos(0.01 * np.arange(700))))
    path = tmp_path / "card.csv"
    path.write_text("time,voltage,displacement\nms,V,nm\nclock,AI0,AI1\n" + rows)
    recording = read_recording(path)
    assert recording.sample_periods_s[0] == pytest.approx(5e-4)
    assert recording.displacement_um.min() == pytest.approx(-12.0, abs=0.01)


def test_time_without_a_unit_is_said_with_how_to_give_another(tmp_path):
    path = tmp_path / "bare.csv"
    path.write_text("time,voltage [V],displacement [um]\n" + "".join(
        f"{0.5 * n:.1f},{n % 50},{0.1 * (n % 50):.3f}\n" for n in range(200)))
    [note] = read_recording(path).notes
    assert "taken for the time in s" in note and "--columns time=time[ms]" in note
    in_ms = read_recording(path, columns=parse_columns(["time=time[ms]"]))
    assert in_ms.sample_periods_s[0] == pytest.approx(5e-4) and not in_ms.notes


def test_columns_of_a_german_spreadsheet_keep_their_units(tmp_path):
    path = tmp_path / "excel.csv"
    text = "Time [s];Piezo (V);Pos/nm\r\n" + "".join(
        f"{0.0005 * n:.4f};{n % 50},25;{-100 * (n % 50)},5\r\n".replace(".", ",")
        for n in range(200))
    path.write_bytes(("\ufeff" + text).encode())
    recording = read_recording(path)
    assert recording.sample_periods_s[0] == pytest.approx(5e-4)
    assert recording.voltage_v.max() == 49.25
    assert recording.displacement_um.min() == pytest.approx(-4.9005)
