# SPDX-License-Identifier: BSD-3-Clause
"""A recording opens as a frame or a dataset with units; without the library it says what to do."""

import sys

import numpy as np
import pytest

from piezo_recorder.reading.frames import read_frame
from piezo_recorder.reading.memory import recording_of
from piezo_recorder.reading.reader import read_recording
from piezo_recorder.reading.recording import RecordingError
from piezo_recorder.sample_block import Flag

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
    assert frame.attrs["units"] == {"time_s": "s", "voltage_v": "V", "displacement_um": "um"}
    assert frame.attrs["sample_rate_hz"] == 2.0 and frame.attrs["source"] == str(recording)


def test_dataset_knows_units_and_flags_and_becomes_the_recording_again(recording, tmp_path):
    xarray = pytest.importorskip("xarray")
    read = read_recording(recording)
    # CF conventions, which netCDF keeps: a file of the dataset says as much as the dataset.
    whole = {name: {"dtype": "i4"} for name in ("sample_index", "flags")}
    read.to_xarray().to_netcdf(tmp_path / "recording.nc", engine="scipy",
                               format="NETCDF3_CLASSIC", encoding=whole)
    with xarray.open_dataset(tmp_path / "recording.nc", engine="scipy") as dataset:
        assert {name: dataset[name].units for name in ("voltage_v", "displacement_um")} == {
            "voltage_v": "V", "displacement_um": "um"}
        assert dataset.attrs["sample_rate_hz"] == 2.0
        again = recording_of(dataset)
    np.testing.assert_array_equal(again.time_s, read.time_s)
    np.testing.assert_array_equal(again.voltage_v, read.voltage_v)
    np.testing.assert_array_equal(again.flags, read.flags)
    np.testing.assert_array_equal(again.columns["temperature_c"], [20.0, 21.0, 22.0])


def test_flags_of_a_dataset_are_named(recording):
    pytest.importorskip("xarray")
    flags = read_recording(recording).to_xarray()["flags"]
    named = dict(zip(flags.flag_meanings.split(), flags.flag_masks, strict=True))
    assert named["playing"] == Flag.PLAYING and len(named) == len(Flag)
    assert np.all(flags.to_numpy() & named["playing"])


def test_dataset_of_others_is_read_by_its_units():
    xarray = pytest.importorskip("xarray")
    time = ("t", [0.0, 500.0, 1000.0], {"units": "ms"})
    recording = recording_of(xarray.Dataset(
        {"monitor": ("t", [1.0, 2.0, 3.0], {"units": "V"}),
         "gauge": ("t", [10.0, 11.0, 12.0], {"units": "nm"}), "trial": 7}, {"t": time}))
    np.testing.assert_allclose(recording.time_s, [0.0, 0.5, 1.0])
    np.testing.assert_allclose(recording.displacement_um, [0.010, 0.011, 0.012])


@pytest.mark.parametrize(("library", "view"), [("pandas", "to_frame"), ("xarray", "to_xarray")])
def test_missing_library_is_said_with_the_cure(recording, monkeypatch, library, view):
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(RecordingError, match=f"{library} is not installed: install it"):
        getattr(read_recording(recording), view)()
