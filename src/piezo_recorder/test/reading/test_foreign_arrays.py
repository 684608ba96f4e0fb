# SPDX-License-Identifier: BSD-3-Clause
"""Files that other libraries wrote are read to the numbers that they were given."""

import io
import sys
import zipfile
from datetime import datetime, time, timedelta

import numpy as np
import pandas
import pytest
import scipy.io

from piezo_recorder.reading.columns import parse_columns
from piezo_recorder.reading.reader import read_recording, read_recordings
from piezo_recorder.reading.recording import RecordingError

ROWS = 500
TIME_S = 7.0 + 1e-3 * np.arange(ROWS)
VOLTAGE_V = 50.0 - 50.0 * np.cos(np.arange(ROWS) / 40.0)
DISPLACEMENT_UM = 0.3 * VOLTAGE_V + 0.1 * np.sin(np.arange(ROWS))


def write_npz(path):
    np.savez(path, t_ms=1e3 * TIME_S, voltage_v=VOLTAGE_V, displacement_nm=1e3 * DISPLACEMENT_UM,
             remark=np.array("a text"))


def write_structured_npy(path):
    np.save(path, np.rec.fromarrays([TIME_S, VOLTAGE_V, DISPLACEMENT_UM],
                                    names="time_s,voltage_v,displacement_um"))


def write_mat(path):
    scipy.io.savemat(path, {"t": TIME_S, "u_V": VOLTAGE_V, "pos_nm": 1e3 * DISPLACEMENT_UM})


def write_mat_v4(path):
    scipy.io.savemat(path, {"t": TIME_S, "u_V": VOLTAGE_V, "pos_nm": 1e3 * DISPLACEMENT_UM},
                     format="4")


def write_struct_mat(path):
    scipy.io.savemat(path, {"remark": "made by hand", "data": {
        "time_s": TIME_S, "Vpiezo": VOLTAGE_V, "y_um": DISPLACEMENT_UM}})


def capture(signals, time_s=TIME_S):
    """What ControlDesk of dSPACE saves: structures of names and data."""
    kinds = [("Name", object), ("Data", object), ("Unit", object)]
    return {"X": {"Name": [], "Data": time_s, "Unit": []},
            "Y": np.array([tuple(each) for each in signals], dtype=kinds),
            "Capture": {"DateTime": "2014-05-09", "SamplingPeriod": 1e-3}}


def write_capture(path):
    scipy.io.savemat(path, {"run_1": capture([
        ('"Model Root"/"voltage"/"In1"', VOLTAGE_V, []),
        ('"Model Root"/"sensor"/"In1"', 1e3 * DISPLACEMENT_UM, "nm"),
        ('"Model Root"/"Pos.\x1adelay"/"In1"', 0.0 * VOLTAGE_V, [])])})


def write_mat_with_rate(path):
    scipy.io.savemat(path, {"Fs": 1000.0, "voltage_V": VOLTAGE_V, "y_um": DISPLACEMENT_UM})


def write_hdf5(path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        for name, values, unit in (("t", 1e3 * TIME_S, "ms"), ("voltage", VOLTAGE_V, "V"),
                                   ("position", 1e3 * DISPLACEMENT_UM, "nm")):
            file[f"run/{name}"] = values
            file[f"run/{name}"].attrs["unit"] = unit


def write_mat_v73(path):
    """A file as MATLAB writes it: HDF5 behind a block of text, vectors as 1 x N."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in (("t", TIME_S), ("u", VOLTAGE_V), ("pos_um", DISPLACEMENT_UM)):
            file[name] = values.reshape(1, -1)
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
        file["remark"] = np.array([[65, 66, 67]], dtype=np.uint16)
        file["remark"].attrs["MATLAB_class"] = np.bytes_("char")
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def write_tdms(path):
    nptdms = pytest.importorskip("nptdms")
    waveform = {"wf_increment": 1e-3, "wf_start_offset": 7.0}
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment([
            nptdms.ChannelObject("Measurement", "Piezo voltage", VOLTAGE_V,
                                 {**waveform, "unit_string": "V"}),
            nptdms.ChannelObject("Measurement", "Position", 1e3 * DISPLACEMENT_UM,
                                 {**waveform, "unit_string": "nm"})])


def write_parquet(path):
    pytest.importorskip("pyarrow")
    pandas.DataFrame({
        "when": pandas.Timestamp("2026-03-01") + pandas.to_timedelta(TIME_S, unit="s"),
        "Voltage [V]": VOLTAGE_V, "Position [um]": DISPLACEMENT_UM, "by": "me"}).rename(
            columns={"when": "timestamp"}).to_parquet(path)


def write_feather(path):
    pytest.importorskip("pyarrow")
    pandas.DataFrame({"time_s": TIME_S, "voltage_v": VOLTAGE_V,
                      "displacement_um": DISPLACEMENT_UM}).to_feather(path)


WRITERS = {"a.npz": write_npz, "b.npy": write_structured_npy, "c.mat": write_mat,
           "d.mat": write_struct_mat, "e.mat": write_mat_with_rate, "f.h5": write_hdf5,
           "g.mat": write_mat_v73, "h.tdms": write_tdms, "i.parquet": write_parquet,
           "j.feather": write_feather, "k.mat": write_mat_v4, "l.mat": write_capture}
OTHER_MATLAB_FILES = ("d.mat", "e.mat", "k.mat", "l.mat")
"""Read by the library that reads c.mat, which starts a process of its own."""
CUT_LIKE_ANOTHER = ("d.mat", "e.mat", "l.mat")
"""Of the version of c.mat; that of k.mat has no magic."""


@pytest.mark.parametrize("name", WRITERS)
def test_file_of_another_library_is_read_to_the_numbers_that_it_was_given(
        tmp_path, request, name):
    if name in OTHER_MATLAB_FILES:
        request.getfixturevalue("matlab_in_place")
    path = tmp_path / name
    WRITERS[name](path)
    recording = read_recording(path)
    np.testing.assert_allclose(recording.voltage_v, VOLTAGE_V, atol=1e-9)
    np.testing.assert_allclose(recording.displacement_um, DISPLACEMENT_UM, atol=1e-9)
    assert recording.sample_period_s == pytest.approx(1e-3, rel=1e-6)
    assert recording.time_s[0] == 0.0


@pytest.mark.parametrize("name", [
    pytest.param(name, marks=[pytest.mark.long] if name in CUT_LIKE_ANOTHER else [])
    for name in WRITERS])
@pytest.mark.parametrize("kept", [
    0.5, *(pytest.param(kept, marks=pytest.mark.long) for kept in (0.02, 0.9))])
def test_file_that_was_cut_short_is_read_or_refused_in_one_line(tmp_path, name, kept):
    path = tmp_path / name
    WRITERS[name](path)
    content = path.read_bytes()
    path.write_bytes(content[: int(kept * len(content))])
    try:
        recording = read_recording(path)
    except RecordingError as refusal:
        assert str(refusal).startswith(str(path))
        assert "\n" not in str(refusal)
    else:
        # NumPy and TDMS tell their rows as they come.
        assert name in ("h.tdms",)
        assert len(recording.voltage_v) < ROWS


@pytest.mark.usefixtures("matlab_in_place")
def test_signals_of_a_capture_have_the_words_that_tell_their_blocks_apart(tmp_path):
    """ControlDesk names each signal by the path of its block in the model."""
    write_capture(tmp_path / "run.mat")
    with pytest.raises(RecordingError, match="no column 'x'") as told:
        read_recording(tmp_path / "run.mat", columns=parse_columns(["voltage=x[V]"]))
    for label in ("run_1.time [s]", "run_1.voltage", "run_1.sensor [nm]", "run_1.Pos__delay"):
        assert f"'{label}'" in str(told.value)


def test_plain_array_has_columns_by_number(tmp_path):
    np.save(tmp_path / "plain.npy", np.column_stack([TIME_S, VOLTAGE_V, DISPLACEMENT_UM]))
    with pytest.raises(RecordingError, match="none of '1', '2', '3'"):
        read_recording(tmp_path / "plain.npy")
    recording = read_recording(tmp_path / "plain.npy", columns=parse_columns(
        ["time=1[s]", "voltage=2[V]", "displacement=3[um]"]))
    np.testing.assert_array_equal(recording.voltage_v, VOLTAGE_V)


def test_groups_of_a_file_are_recordings(tmp_path):
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "runs.h5"
    with h5py.File(path, "w") as file:
        file["fs"] = 1000.0
        for run in (1, 2):
            file[f"run{run}/voltage_v"] = run * VOLTAGE_V
            file[f"run{run}/displacement_um"] = run * DISPLACEMENT_UM
    first, second = read_recordings(path)
    assert (first.title, second.title) == ("run1", "run2")
    np.testing.assert_allclose(second.voltage_v, 2.0 * VOLTAGE_V)
    one = read_recording(path, columns=parse_columns(["recording=[run2]"]))
    np.testing.assert_array_equal(one.voltage_v, second.voltage_v)


def empty_workbook():
    """Return the bytes by which a workbook is known."""
    written = io.BytesIO()
    with zipfile.ZipFile(written, "w") as archive:
        archive.writestr("[Content_Types].xml", "<xml/>")
    return written.getvalue()


@pytest.mark.parametrize("module, content, package", [
    ("h5py", b"\x89HDF\r\n\x1a\n" + bytes(600), "h5py"),
    ("nptdms", b"TDSm" + bytes(60), "nptdms"),
    ("pyarrow.parquet", b"PAR1" + bytes(60), "pyarrow"),
    ("pyarrow.ipc", b"ARROW1" + bytes(60), "pyarrow"),
    ("openpyxl", empty_workbook(), "openpyxl"),
])
def test_library_that_is_missing_is_named_in_one_line(
        tmp_path, monkeypatch, module, content, package):
    monkeypatch.setitem(sys.modules, module, None)
    path = tmp_path / "data.bin"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=f"needs the package {package}.*install it"):
        read_recording(path)


def test_archive_of_objects_is_refused_with_what_to_do(tmp_path):
    np.savez(tmp_path / "objects.npz", a=np.array([{}, {}], dtype=object))
    with pytest.raises(RecordingError, match="holds no columns of numbers"):
        read_recording(tmp_path / "objects.npz")


def test_sheet_is_read_below_its_labels(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["measured on a stage"])
    book.active.append(["t [ms]", "U [V]", "pos [nm]", "remark"])
    for row, (voltage_v, displacement_um) in enumerate(
            zip(VOLTAGE_V, DISPLACEMENT_UM, strict=True)):
        book.active.append([row * 0.5, voltage_v, 1e3 * displacement_um, "good"])
    book.create_sheet("notes").append(["nothing here"])
    book.save(tmp_path / "book.xlsx")
    recording = read_recording(tmp_path / "book.xlsx")
    np.testing.assert_allclose(recording.voltage_v, VOLTAGE_V)
    np.testing.assert_allclose(recording.displacement_um, DISPLACEMENT_UM)
    assert recording.sample_period_s == pytest.approx(0.5e-3)


@pytest.mark.parametrize("begin", [
    datetime(2026, 3, 4, 23, 59, 59, 900_000), datetime(2026, 3, 4, 23, 59, 59, 900_000).time(),
    timedelta(hours=30)], ids=["dates", "times of the day", "durations"])
def test_times_of_a_sheet_are_seconds(tmp_path, begin):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["Time", "U [V]", "pos [um]"])
    for row, (voltage_v, displacement_um) in enumerate(
            zip(VOLTAGE_V, DISPLACEMENT_UM, strict=True)):
        later = timedelta(milliseconds=2 * row)
        at = ((datetime.combine(datetime(2026, 3, 4), begin) + later).time()
              if isinstance(begin, time) else begin + later)
        book.active.append([at, voltage_v, displacement_um])
    for cells in book.active.iter_rows(min_row=2, max_col=1):
        if isinstance(begin, timedelta):
            cells[0].number_format = "[h]:mm:ss.000"
    book.save(tmp_path / "book.xlsx")
    recording = read_recording(tmp_path / "book.xlsx")
    np.testing.assert_allclose(recording.displacement_um, DISPLACEMENT_UM)
    assert recording.sample_period_s == pytest.approx(2e-3)
