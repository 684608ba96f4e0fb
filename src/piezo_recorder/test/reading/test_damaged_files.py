# SPDX-License-Identifier: BSD-3-Clause
"""Random damage inside a file of any kind ends in one line, or in a recording; never otherwise."""

import random
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from piezo_common.cancellation import checking
from piezo_recorder.reading.reader import MCAP_MAGIC, read_recordings
from piezo_recorder.reading.recording import RecordingError
from piezo_recorder.reading.tables import matlab_files

ROWS = 60
COLUMNS = {"time_s": 1e-3 * np.arange(ROWS),
           "voltage_v": 50.0 - 50.0 * np.cos(np.arange(ROWS) / 7.0),
           "displacement_um": 15.0 - 15.0 * np.cos(np.arange(ROWS) / 7.0 - 0.1)}


def write_text(path):
    np.savetxt(path, np.column_stack(list(COLUMNS.values())), delimiter=";",
               header=";".join(COLUMNS), comments="")


def write_npy(path):
    np.save(path, np.rec.fromarrays(list(COLUMNS.values()), names=",".join(COLUMNS)))


def write_hdf5(path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        for name, values in COLUMNS.items():
            file[f"run/{name}"] = values


def write_tdms(path):
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment([nptdms.ChannelObject("run", name, values)
                              for name, values in COLUMNS.items()])


def write_parquet(path):
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    parquet.write_table(arrow.table(COLUMNS), path)


def write_feather(path):
    arrow, feather = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.feather")
    feather.write_feather(arrow.table(COLUMNS), path)


def write_matlab(path):
    scipy.io.savemat(path, {"data": COLUMNS})


# A MATLAB file takes a process of its own, and half a second.
KINDS = {"a.csv": (write_text, 40), "b.npz": (lambda path: np.savez(path, **COLUMNS), 40),
         "c.npy": (write_npy, 40), "d.h5": (write_hdf5, 40), "e.tdms": (write_tdms, 40),
         "f.parquet": (write_parquet, 40), "g.feather": (write_feather, 40),
         "h.mat": (write_matlab, 2)}


def damaged(content, seed):
    """Flip, overwrite, remove or insert some bytes, half of them near the beginning."""
    draw, changed = random.Random(seed), bytearray(content)
    kind = draw.randrange(5)
    for _ in range(draw.choice([1, 1, 2, 4, 16])):
        at = draw.randrange(min(len(changed), 700) if draw.random() < 0.5 else len(changed))
        if kind == 0:
            changed[at] ^= 1 << draw.randrange(8)
        elif kind == 1:
            changed[at] = draw.choice([0, 1, 0x7F, 0x80, 0xFF])
        elif kind == 2:
            changed[at : at + 4] = draw.choice([bytes(4), b"\xff" * 4, b"\xff\xff\xff\x7f"])
        elif kind == 3:
            del changed[at : at + draw.randrange(1, 9)]
        else:
            changed[at:at] = draw.randbytes(draw.randrange(1, 9))
    return bytes(changed)


@pytest.mark.parametrize("name", KINDS)
def test_random_damage_is_read_or_refused_in_one_line_and_nothing_is_printed(
        tmp_path, capfd, name):
    write, draws = KINDS[name]
    path = tmp_path / name
    write(path)
    content = path.read_bytes()
    refused = 0
    for seed in range(draws):
        path.write_bytes(damaged(content, seed))
        try:
            found = read_recordings(path)
        except RecordingError as refusal:
            assert str(refusal).startswith(str(path)), seed
            assert "\n" not in str(refusal) and len(str(refusal)) < len(str(path)) + 500, seed
            refused += 1
        else:
            notes = [note for recording in found for note in recording.notes]
            assert all("\n" not in note and len(note) < 500 for note in notes), seed
    assert refused
    assert capfd.readouterr() == ("", "")


def refusal_of(path):
    with pytest.raises(RecordingError) as refusal:
        read_recordings(path)
    assert "\n" not in str(refusal.value)
    return str(refusal.value)


def test_matlab_file_whose_numbers_are_of_no_known_type_is_refused(tmp_path):
    """SciPy looks the type up in a table without its bounds: most such files crash it."""
    path = tmp_path / "type.mat"
    scipy.io.savemat(path, COLUMNS)
    content = bytearray(path.read_bytes())
    of_numbers = content.index(b"time_s\0\0\x09") + 8
    content[of_numbers] = 0x89
    path.write_bytes(content)
    assert "is a damaged MATLAB file" in refusal_of(path)


def test_matlab_file_that_claims_two_thousand_million_structures_is_refused(tmp_path):
    path = tmp_path / "large.mat"
    write_matlab(path)
    content = bytearray(path.read_bytes())
    shape = content.index((1).to_bytes(4, "little") * 2)
    content[shape : shape + 4] = (2**31 - 1).to_bytes(4, "little")
    path.write_bytes(content)
    assert "is a damaged MATLAB file" in refusal_of(path)


@pytest.mark.parametrize("program, limit_s, said", [
    ("import os; os.abort()", 60.0, "its reader crashes on it"),
    ("while True: pass", 0.1, "it is not read within"),
    ("raise SystemExit('two\\nlines')", 60.0, "two lines"),
])
def test_reader_of_matlab_files_that_fails_is_told_in_one_line(
        tmp_path, monkeypatch, program, limit_s, said):
    path, reader = tmp_path / "any.mat", tmp_path / "reader.py"
    write_matlab(path)
    reader.write_text(program)
    monkeypatch.setattr(matlab_files, "READER", Path(reader))
    monkeypatch.setattr(matlab_files, "LEAST_LIMIT_S", limit_s)
    assert f"is a damaged MATLAB file ({said}" in refusal_of(path)


def write_two_segments(path):
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(path) as writer:
        for _ in range(2):
            writer.write_segment([nptdms.ChannelObject("run", name, values)
                                  for name, values in COLUMNS.items()])


def test_tdms_file_without_its_last_segment_is_read_and_says_so(tmp_path, capfd):
    path = tmp_path / "cut.tdms"
    write_two_segments(path)
    path.write_bytes(path.read_bytes()[: -8 * len(COLUMNS) * ROWS])
    recording, = read_recordings(path)
    np.testing.assert_array_equal(recording.voltage_v, COLUMNS["voltage_v"])
    assert any("damaged or cut short" in note for note in recording.notes)
    assert capfd.readouterr() == ("", "")


def test_tdms_file_that_was_cut_within_its_last_column_names_that_column(tmp_path):
    path = tmp_path / "cut.tdms"
    write_tdms(path)
    path.write_bytes(path.read_bytes()[:-80])
    assert f"'displacement_um' has {ROWS - 10} values where other columns have {ROWS}" in (
        refusal_of(path))


class GivenUp(Exception):
    pass


@pytest.mark.parametrize(("name", "head"), [
    ("zeros.mcap", MCAP_MAGIC), ("unknown.mcap", MCAP_MAGIC + b"\x80" + bytes(8)),
    ("rows.csv", b"time_s,voltage_v,displacement_um\n" + b"".join(
        b"%.3f,%d,%d\n" % (1e-3 * row, row % 7, row % 5) for row in range(1000)))])
def test_read_is_given_up_within_a_file_of_any_size(tmp_path, name, head):
    path = tmp_path / name
    with open(path, "wb") as file:
        file.write(head)
        if name.endswith(".mcap"):
            file.truncate(10_000_000)
    looks = iter([False])

    def check():
        if next(looks, True):
            raise GivenUp

    # More than the one look where the file has ended.
    with checking(check), pytest.raises(GivenUp):
        read_recordings(path)


def test_line_without_end_is_refused_before_all_of_it_is_read(tmp_path):
    path = tmp_path / "rows.csv"
    with open(path, "wb") as file:
        file.write(b"time_s,voltage_v,displacement_um\n" + b"".join(
            b"%.3f,%d,%d\n" % (1e-3 * row, row % 7, row % 5) for row in range(30_000)))
        file.truncate(3 * 2**30)
    with pytest.raises(RecordingError, match="has a line of more than"):
        read_recordings(path)
