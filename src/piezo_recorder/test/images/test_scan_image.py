# SPDX-License-Identifier: BSD-3-Clause
"""Images show the specimen where it is, wherever the stage went to see it."""

import sys

import numpy as np
import pytest
from rasters import CENTRE_UM, COLUMNS, PIXEL_UM, ROWS, frame, raster, recorded, specimen
from scipy.ndimage import map_coordinates

from piezo_common.gsf import read_gsf, write_gsf
from piezo_recorder.commands.image_command import main
from piezo_recorder.images.geometric_error import error_by_sensors, error_by_specimen
from piezo_recorder.images.image_files import write_image
from piezo_recorder.images.scan_image import image_of
from piezo_recorder.reading.recording import RecordingError


def distorted(position_um):
    """Positions that are stretched, sheared and bent by up to some pixels."""
    x, y = (position_um - CENTRE_UM).T
    return np.column_stack([1.04 * x + 0.03 * y + 0.02 * x**2, 0.97 * y - 0.01 * x * y]) + CENTRE_UM


@pytest.mark.parametrize("way", [1, -1])
def test_image_by_measured_positions_is_that_of_the_specimen(way):
    image = image_of(recorded(*raster(way)))
    assert image.signal == "height_um" and image.unit == "um"
    assert image.values.shape == (ROWS, COLUMNS)
    field = specimen()
    places = frame().places_um()
    wanted_um = map_coordinates(field.values, field.pixels_at(places.reshape(-1, 2)))
    left_um = image.values - wanted_um.reshape(ROWS, COLUMNS)
    assert np.std(left_um) < 0.05 * np.std(wanted_um)
    assert error_by_sensors(image).rms < 0.02
    assert error_by_specimen(image, field).rms < 0.04


def test_lateness_that_is_not_known_shifts_the_lines_of_both_directions_apart():
    recording = recorded(*raster(-1))
    late = image_of(recording, frame=frame(sensor_delay_s=[0.0, 0.0]))
    assert error_by_specimen(late, specimen()).rms < 0.1
    assert np.nanstd(late.values - image_of(recording).values) > 0.0005


def test_distortion_is_seen_by_sensors_and_specimen_and_undone_by_measured_positions():
    commanded_um, marks = raster()
    recording = recorded(commanded_um, marks, distorted(commanded_um))
    late_um = recorded(commanded_um, marks).displacement_um
    image = image_of(recording, position_um=late_um)
    moved = (distorted(frame().places_um().reshape(-1, 2)) - frame().places_um().reshape(-1, 2)
             ) / PIXEL_UM
    wanted = np.sqrt(np.mean(np.sum((moved - moved.mean(axis=0)) ** 2, axis=1)))
    assert error_by_sensors(image).rms == pytest.approx(wanted, rel=0.01)
    known = error_by_specimen(image, specimen())
    assert known.rms == pytest.approx(wanted, rel=0.1) and known.rms_calibrated < 0.7 * known.rms
    mended = image_of(recording)
    assert error_by_specimen(mended, specimen()).rms < 0.04 < 0.1 * wanted


def test_deviation_is_that_of_the_mean_of_a_pixel():
    commanded_um, marks = raster()
    still_um = np.tile(commanded_um[:1], (len(commanded_um), 1))
    recording = recorded(commanded_um, marks, still_um, noise_um=0.02)
    image = image_of(recording, position_um=commanded_um)
    assert np.median(image.deviation) == pytest.approx(0.02 / np.sqrt(11), rel=0.05)


def test_pixels_that_were_not_reached_are_not_filled():
    commanded_um, marks = raster()
    away = recorded(commanded_um, marks, commanded_um + [10 * PIXEL_UM[0], 0.0])
    lacking = np.isnan(image_of(away).values)
    assert lacking[:, :9].all() and not lacking[:, 11:].any()


def test_gap_between_the_positions_is_left_empty():
    commanded_um, marks = raster()
    x = commanded_um[:, 0] - CENTRE_UM[0]
    split_um = np.column_stack([commanded_um[:, 0] + np.where(x > 0.0, 4 * PIXEL_UM[0], 0.0),
                                commanded_um[:, 1]])
    lacking = np.isnan(image_of(recorded(commanded_um, marks, split_um)).values[1:-1, 20:32])
    assert np.all(lacking.any(axis=1)) and np.all(lacking.sum(axis=1) <= 3)


def test_last_frame_counts():
    commanded_um, marks = raster()
    twice = recorded(np.tile(commanded_um, (2, 1)), np.tile(marks, 2),
                     np.concatenate([distorted(commanded_um), commanded_um]))
    late_um = np.tile(recorded(commanded_um, marks).displacement_um, (2, 1))
    assert error_by_sensors(image_of(twice, position_um=late_um)).rms < 0.05


@pytest.mark.parametrize(("signal", "changes", "words"), [
    ("sound", {}, r"the signals height_um, camera: choose one"),
    ("", {"columns": {}}, r"the signals \(none\): record a stage with a detector"),
    ("", {"attachments": {}}, r"holds no scan\.json: record a scan"),
    ("", {"attachments": {"scan.json": b"{}"}}, r"scan\.json format is null"),
])
def test_recordings_that_give_no_image_are_refused(signal, changes, words):
    recording = recorded(*raster())
    for name, value in changes.items():
        object.__setattr__(recording, name, value)
    with pytest.raises(RecordingError, match=words):
        image_of(recording, signal)


def test_part_of_a_frame_is_refused():
    commanded_um, marks = raster()
    with pytest.raises(RecordingError, match="a frame has 1920: record a whole frame"):
        image_of(recorded(commanded_um[:9000], marks[:9000]))


def test_files_hold_the_image_with_its_place_and_units(tmp_path):
    image = image_of(recorded(*raster()))
    assert not [line for line in write_image(image, tmp_path, "scan") if "missing" in line]
    field = read_gsf(tmp_path / "scan.gsf")
    np.testing.assert_allclose(field.values, image.values, atol=1e-7)
    assert field.size_um == pytest.approx((4.8, 4.8)) and field.unit == "um"
    assert field.corner_um == pytest.approx((2.6, -4.4))
    assert read_gsf(tmp_path / "scan_deviation.gsf").values.shape == (ROWS, COLUMNS)
    assert (tmp_path / "scan.png").read_bytes().startswith(b"\x89PNG")
    gwyfile = pytest.importorskip("gwyfile")
    channel = gwyfile.load(str(tmp_path / "scan.gwy"))["/0/data"]
    np.testing.assert_allclose(channel.data, 1e-6 * image.values)
    assert channel.xreal == pytest.approx(4.8e-6) and channel.yoff == pytest.approx(-4.4e-6)
    assert channel.si_unit_z.unitstr == "m"
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "scan.h5") as file:
        assert file["height_um"].dims[1][0].name == "/x_um"
        np.testing.assert_allclose(file["y_um"], frame().places_um()[:, 0, 1])
        assert file["height_um"].attrs["units"] == "um"
        assert file["visited_um"].shape == (COLUMNS * ROWS, 2)


def test_files_whose_library_is_missing_are_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "gwyfile", None)
    monkeypatch.setitem(sys.modules, "gwyfile.objects", None)
    lines = list(write_image(image_of(recorded(*raster())), tmp_path, "scan"))
    assert any("scan.gwy; gwyfile is missing: install it" in line for line in lines)
    assert (tmp_path / "scan.h5").exists()


def test_command_makes_images_and_a_page_from_recordings(tmp_path, sample_blocks, capsys):
    recording = recorded(*raster())
    blocks = [sample_blocks.serialise(
        first * 4, recording.voltage_v[part], recording.displacement_um[part], 1e-4,
        axes=("x", "y"), marks=recording.marks[part], signals=["height_um"],
        signal=recording.signals["height_um"][part])
        for first in range(0, len(recording.voltage_v), 400)
        for part in [slice(first, first + 400)]]
    sample_blocks.write(tmp_path / "run", {"/stage/samples": blocks}, 40_000.0,
                        recording.attachments.items())
    write_gsf(tmp_path / "specimen.gsf", specimen())
    assert main(["--data", str(tmp_path / "run"), "--specimen", str(tmp_path / "specimen.gsf"),
                 "--output", str(tmp_path / "images")]) == 0
    printed = capsys.readouterr().out
    assert "Geometric error, RMS in pixels" in printed and "report: " in printed
    assert "<h2>Images</h2>" in (tmp_path / "images" / "report.html").read_text()
    assert (tmp_path / "images" / "run.gsf").exists()
    assert main(["--data", str(tmp_path / "run"), "--signal", "sound",
                 "--output", str(tmp_path / "images")]) == 2


@pytest.mark.parametrize("pixel_um", [0.12, 0.0])
def test_pixels_on_a_line_make_no_image(pixel_um):
    commanded_um, marks = raster()
    commanded_um[:, 1] = CENTRE_UM[1]
    recording = recorded(commanded_um, marks)
    with pytest.raises(RecordingError, match="the pixels of the raster of a test lie on a line"):
        image_of(recording, frame=frame(pixel_um=[PIXEL_UM[0], pixel_um]))
