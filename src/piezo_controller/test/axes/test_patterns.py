# SPDX-License-Identifier: BSD-3-Clause
"""Paths close without a jump, keep their speeds and are marked where lines and pixels are."""

import json
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezo_controller.axes.patterns import KINDS, PATTERNS, ScanPattern, scan_path
from piezo_controller.axes.spec_path import path_of_spec, spec_of_file
from piezo_controller.commands import scan_command
from piezo_controller.references.kind import InvalidReference
from piezo_recorder.reading.detected import mark_columns
from piezo_recorder.sample_block import Mark

PERIOD_S = 1e-4
POINTS_UM = [[0.0, 0.0], [1.0, 3.0], [-2.0, 1.0]]
EACH = [
    {"kind": "raster"}, {"kind": "raster", "both_directions": True},
    {"kind": "raster", "frame_flyback_s": 0.01}, {"kind": "spiral"},
    {"kind": "spiral", "linear_velocity": True}, {"kind": "lissajous"}, {"kind": "rosette"},
    {"kind": "cycloid"}, {"kind": "points", "points_um": POINTS_UM}]


def drawn(sample_period_s=PERIOD_S, **fields):
    pattern = {"size_um": (20.0, 10.0), "rate_hz": 50.0, "lines": 8, **fields}
    return scan_path(ScanPattern(**pattern), sample_period_s)


def marked(path, mark):
    return np.flatnonzero(path.marks & mark)


def bends_um(path, order):
    """Return the largest difference of an order, round the end of the period as well."""
    around = np.concatenate([path.position_um, path.position_um[:order]])
    return np.abs(np.diff(around, order, axis=0)).max()


@pytest.mark.parametrize("fields", EACH, ids=str)
def test_position_speed_and_acceleration_go_on_without_a_jump(fields):
    # The third difference falls with the third power of the sample period where nothing jumps.
    coarse, fine = drawn(PERIOD_S / 4.0, **fields), drawn(PERIOD_S / 8.0, **fields)
    assert len(fine.position_um) == pytest.approx(2 * len(coarse.position_um), abs=2)
    assert bends_um(fine, 3) < 1.2 * bends_um(coarse, 3) / 8.0


@given(st.integers(2, 12), st.sampled_from([20.0, 50.0, 200.0]), st.booleans(),
       st.floats(0.1, 0.6), st.floats(1.0, 20.0))
def test_lines_of_a_raster_are_straight_at_constant_speed(lines, rate_hz, both, share, factor):
    flyback_s = share / rate_hz
    path = drawn(lines=lines, rate_hz=rate_hz, both_directions=both, flyback_s=flyback_s,
                 frame_flyback_s=factor * flyback_s, pixels=5)
    begins = marked(path, Mark.LINE)
    assert begins.size == lines
    assert marked(path, Mark.FRAME).tolist() == [0]
    straight = int((1.0 / rate_hz - flyback_s) / PERIOD_S + 1e-6)
    for number, begin in enumerate(begins):
        line_um = path.position_um[begin:begin + straight + 1]
        way = -1.0 if both and number % 2 else 1.0
        speed_um = 20.0 * way * PERIOD_S / (1.0 / rate_hz - flyback_s)
        np.testing.assert_allclose(
            line_um[:, 0], -10.0 * way + speed_um * np.arange(straight + 1), atol=1e-9)
        np.testing.assert_allclose(line_um[:, 1], -5.0 + 10.0 * number / (lines - 1), atol=1e-9)
        assert bool(path.marks[begin] & Mark.BACKWARD) == (way < 0.0)
    pixels_um = path.position_um[marked(path, Mark.PIXEL), 0].reshape(lines, 5)
    centres_um = np.array([-8.0, -4.0, 0.0, 4.0, 8.0])
    for row_um, begin in zip(pixels_um, begins, strict=True):
        backward = path.marks[begin] & Mark.BACKWARD
        np.testing.assert_allclose(row_um, centres_um[::-1] if backward else centres_um,
                                   atol=0.5 * abs(speed_um) + 1e-9)


def test_the_spirals_keep_their_angular_or_linear_velocity():
    def speeds(path):
        step_um = np.linalg.norm(np.diff(path.position_um, axis=0), axis=1)
        radius_um = np.linalg.norm(path.position_um[:-1], axis=1)
        return step_um / PERIOD_S, radius_um

    straight_um = 8.0  # of a radius of 10; turns are beyond 10
    angular, linear = (drawn(kind="spiral", size_um=(20.0, 20.0), lines=20, linear_velocity=each)
                       for each in (False, True))
    speed, radius_um = speeds(angular)
    middle = (radius_um > 4.0) & (radius_um < straight_um)
    np.testing.assert_allclose(speed[middle], 2.0 * np.pi * 50.0 * radius_um[middle], rtol=0.01)
    speed, radius_um = speeds(linear)
    middle = (radius_um > 4.0) & (radius_um < straight_um)
    assert np.ptp(speed[middle]) < 0.02 * speed[middle].mean()
    assert marked(angular, Mark.FRAME).size == 2
    assert np.linalg.norm(angular.position_um[marked(angular, Mark.FRAME)], axis=1).max() < 0.1


@pytest.mark.parametrize("kind", ["lissajous", "rosette"])
def test_figures_of_sines_have_no_content_beyond_their_rate(kind):
    path = drawn(kind=kind)
    lines_um = np.abs(np.fft.rfft(path.position_um, axis=0)) / len(path.position_um)
    frequency_hz = np.fft.rfftfreq(len(path.position_um), PERIOD_S)
    assert lines_um[frequency_hz > 50.0 * 9.0 / 8.0 + 1e-6].max() < 1e-12
    assert np.ptp(path.position_um, axis=0) == pytest.approx([20.0, 10.0], rel=0.03)


def test_points_are_rested_at_from_their_mark_on():
    path = drawn(kind="points", points_um=POINTS_UM)
    for begin, point_um in zip(marked(path, Mark.PIXEL), POINTS_UM, strict=True):
        np.testing.assert_allclose(
            path.position_um[begin:begin + 101], np.tile(point_um, (101, 1)), atol=1e-12)


def test_a_slower_path_is_the_same_path():
    path = drawn(kind="lissajous")
    slower = path.slower(3 * len(path.position_um))
    np.testing.assert_allclose(slower.position_um[::3], path.position_um, atol=1e-9)
    assert slower.rate_hz == pytest.approx(path.rate_hz / 3.0)
    np.testing.assert_array_equal(np.flatnonzero(slower.marks), 3 * np.flatnonzero(path.marks))


def test_a_file_is_read_as_it_was_written(tmp_path):
    path = drawn(kind="rosette")
    table = np.column_stack([path.time_s, path.position_um])
    header = "time_s,x_displacement_um,y_displacement_um"
    file = tmp_path / "path.csv"
    np.savetxt(file, table, "%.12g", ",", header=header, comments="")
    np.testing.assert_allclose(drawn(kind="file", file=file).position_um, path.position_um,
                               atol=1e-9)
    with pytest.raises(InvalidReference, match="resample it to that rate"):
        drawn(2.0 * PERIOD_S, kind="file", file=file)
    np.savetxt(file, table[:-50], "%.12g", ",", header=header, comments="")
    with pytest.raises(InvalidReference, match="jumps by"):
        drawn(kind="file", file=file)
    file.write_text("time_s,x_displacement_um\n0,zero\n")
    with pytest.raises(InvalidReference, match="a row is not of numbers"):
        drawn(kind="file", file=file)


def test_a_file_has_the_marks_of_its_columns(tmp_path):
    path = drawn(kind="raster", lines=8, pixels=6)
    table = np.column_stack([path.time_s, path.position_um, *mark_columns(path.marks).values()])
    header = ",".join(["time_s,x_displacement_um,y_displacement_um", *mark_columns(path.marks)])
    np.savetxt(tmp_path / "own.csv", table, "%.12g", ",", header=header, comments="")
    again = drawn(kind="file", file=tmp_path / "own.csv")
    np.testing.assert_array_equal(again.marks, path.marks)
    without = header.replace(",frame", ",spare")
    np.savetxt(tmp_path / "own.csv", table, "%.12g", ",", header=without, comments="")
    assert drawn(kind="file", file=tmp_path / "own.csv").marks[0] & Mark.FRAME


@pytest.mark.parametrize(("fields", "said"), [
    ({"kind": "zigzag"}, "unknown pattern 'zigzag': use one of raster"),
    ({"rate_hz": 4000.0}, "up to a quarter of the sample rate"),
    ({"size_um": (-1.0, 2.0)}, "give positive numbers"),
    ({"lines": 1}, "give at least 2"),
    ({"flyback_s": 0.03}, "the fly-back takes 0.03 s of a line's 0.02 s"),
    ({"frame_flyback_s": 0.001}, "less than that of a line"),
    ({"pixels": 1000}, "no more pixels than samples"),
    ({"rate_hz": 1e-3}, "change its rate or lines"),
    ({"kind": "points", "points_um": [1.0, 2.0]}, "give two or more"),
    ({"kind": "file"}, "name a CSV")])
def test_what_has_no_meaning_is_refused(fields, said):
    with pytest.raises(InvalidReference, match=said):
        drawn(**fields)


def test_the_command_offers_the_kinds_that_there_are():
    assert scan_command.PATTERNS == (*KINDS, "scanspec")
    assert set(PATTERNS) < set(KINDS)


def test_without_scanspec_its_package_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "scanspec.specs", None)
    with pytest.raises(InvalidReference, match="needs the package scanspec"):
        spec_of_file(tmp_path / "spec.json")


def test_a_specification_of_scanspec_is_crossed_at_the_speed_of_its_frames(tmp_path):
    specs = pytest.importorskip("scanspec.specs")
    spec = specs.Fly(0.004 @ (specs.Linspace("y", 0, 10, 3) * ~specs.Linspace("x", -1, 1, 5)))
    file = tmp_path / "spec.json"
    file.write_text(json.dumps(spec.serialize()))
    path = path_of_spec(spec_of_file(file), PERIOD_S)
    assert path.axes == ("x", "y")
    begins = marked(path, Mark.LINE)
    for begin, way, y_um in zip(begins, (1.0, -1.0, 1.0), (0.0, 5.0, 10.0), strict=True):
        np.testing.assert_allclose(
            path.position_um[begin:begin + 201, 0], way * np.linspace(-1.25, 1.25, 201), atol=1e-9)
        np.testing.assert_allclose(path.position_um[begin:begin + 201, 1], y_um, atol=1e-9)
    np.testing.assert_allclose(
        path.position_um[marked(path, Mark.PIXEL), 0].reshape(3, 5)[0], np.linspace(-1, 1, 5),
        atol=0.01)
    around = np.concatenate([path.position_um, path.position_um[:3]])
    assert np.abs(np.diff(around, 2, axis=0)).max() < 0.1
    with pytest.raises(InvalidReference, match="is no specification"):
        file.write_text("{}")
        spec_of_file(file)
