# SPDX-License-Identifier: BSD-3-Clause
"""Recordings of several axes: tables, arrays in memory, arrays of realisations and periods."""

import numpy as np
import pytest

from piezo_recorder.reading.axes import (
    axes_recordings_in,
    axes_recordings_of_arrays,
    is_of_axes,
    read_axes,
)
from piezo_recorder.reading.reader import read_recording
from piezo_recorder.reading.recording import RecordingError
from piezo_recorder.sample_block import SampleCount

TIME_S = np.arange(50) / 1000.0


def columns():
    rng = np.random.default_rng(1)
    return {"time_s": TIME_S, **{f"{axis}_{signal}": rng.normal(size=50)
                                 for signal in ("voltage_v", "displacement_um")
                                 for axis in ("x", "y")}}


def write(path, table):
    np.savetxt(path, np.column_stack(list(table.values())), "%.17g", ",",
               header=",".join(table), comments="")
    return path


def test_a_table_has_an_array_of_both_axes(tmp_path):
    table = columns() | {"temperature_k": np.full(50, 300.0)}
    path = write(tmp_path / "both.csv", table)
    assert is_of_axes(path)
    found, = read_axes(path)
    assert found.axes == ("x", "y")
    assert found.sample_period_s == pytest.approx(1e-3)
    np.testing.assert_allclose(found.voltage_v[:, 1], table["y_voltage_v"])
    np.testing.assert_allclose(found.displacement_um[:, 0], table["x_displacement_um"])
    same, = axes_recordings_in(table)
    np.testing.assert_allclose(same.displacement_um, found.displacement_um)


def test_what_is_odd_about_one_axis_names_it():
    found, = axes_recordings_in(columns() | {"y_voltage_v": np.zeros(50)})
    odd = [note for note in found.notes if "throughout" in note]
    assert len(odd) == 1 and odd[0].startswith("axis y: ")


def test_npz_is_read_as_text_is(tmp_path):
    np.savez(tmp_path / "both.npz", **columns())
    assert is_of_axes(tmp_path / "both.npz")
    assert read_axes(tmp_path / "both.npz")[0].axes == ("x", "y")


def test_a_table_of_one_axis_is_none_of_several(tmp_path):
    path = write(tmp_path / "one.csv", {"time_s": TIME_S, "voltage_v": TIME_S,
                                        "displacement_um": TIME_S})
    assert not is_of_axes(path)


def arrays():
    rng = np.random.default_rng(2)
    return rng.normal(size=(64, 3, 4, 2)), rng.normal(size=(64, 3, 4, 2)) * 1e-6


def described(folder, text=""):
    voltage_v, displacement_m = arrays()
    np.save(folder / "u.npy", voltage_v)
    np.save(folder / "y.npy", displacement_m)
    path = folder / "mirror.yaml"
    path.write_text("""format: piezo_axes_arrays
axes: [a, b, c]
sample_rate_hz: 6400
voltage: {file: u.npy, unit: V}
displacement: {file: y.npy, unit: m, signs: [1, -1, 1]}
dimensions: [sample, channel, realisation, period]
""" + text)
    return path


def test_arrays_give_a_recording_for_each_realisation(tmp_path):
    path = described(tmp_path)
    assert is_of_axes(path)
    found = read_axes(path)
    voltage_v, displacement_m = arrays()
    assert [each.title for each in found] == ["1", "2", "3", "4"]
    assert found[2].periods == 2
    np.testing.assert_allclose(found[2].voltage_v[64:], voltage_v[:, :, 2, 1])
    np.testing.assert_allclose(found[2].displacement_um[:64, 1], -1e6 * displacement_m[:, 1, 2, 0])


def test_some_realisations_may_be_chosen(tmp_path):
    assert [each.title for each in read_axes(described(tmp_path, "realisations: [4, 1]\n"))] == [
        "4", "1"]


@pytest.mark.parametrize(("text", "words"), [
    ("realisations: [5]\n", "numbers from 1 to 4"),
    ("colour: red\n", "colour"),
])
def test_descriptions_that_do_not_fit_are_refused(tmp_path, text, words):
    with pytest.raises(RecordingError, match=words):
        read_axes(described(tmp_path, text))


@pytest.mark.parametrize(("changes", "words"), [
    ({"dimensions": ("sample", "channel")}, "the dimensions sample, channel"),
    ({"axes": ("a", "b")}, "3 channels and 2 axes"),
    ({"signs": (1.0, 0.0, 1.0)}, "none of them 0"),
])
def test_arrays_that_do_not_fit_are_refused(changes, words):
    fields = {"axes": ("a", "b", "c"),
              "dimensions": ("sample", "channel", "realisation", "period")} | changes
    with pytest.raises(RecordingError, match=words):
        axes_recordings_of_arrays(*arrays(), 6400.0, **fields)


def test_an_axis_that_lacks_values_is_refused():
    table = columns()
    table["y_displacement_um"][-1] = np.nan
    with pytest.raises(RecordingError, match="an axis has no values"):
        axes_recordings_in(table)


MARKS = np.arange(400, dtype=np.uint8) % 16
SIGNAL = np.random.default_rng(5).normal(size=(400, 2))


def marked_blocks(sample_blocks):
    """Blocks of two axes with two detectors; those in the middle have no marks."""
    for first in range(0, 400, 40):
        part = slice(first, first + 40)
        yield sample_blocks.serialise(
            first, np.zeros((40, 2)), np.zeros((40, 2)), axes=("x", "y"),
            marks=() if 100 < first < 300 else MARKS[part], signals=("height_um", "camera"),
            signal=SIGNAL[part])


def test_marks_and_signals_are_columns_of_a_recording_of_a_stage(tmp_path, sample_blocks):
    sample_blocks.write(tmp_path / "run", {"/stage/samples": marked_blocks(sample_blocks)})
    recording, = read_axes(tmp_path / "run")
    assert list(recording.signals) == ["height_um", "camera"]
    assert np.array_equal(recording.signals["camera"], SIGNAL[:, 1])
    assert np.array_equal(recording.columns["camera_signal"], SIGNAL[:, 1])
    middle = (np.arange(400) >= 120) & (np.arange(400) < 320)
    assert np.array_equal(recording.marks, np.where(middle, 0, MARKS))
    assert np.array_equal(recording.columns["line"], recording.marks & 2 > 0)


def test_marks_and_signals_of_a_table_are_kept_without_the_columns_of_axes(tmp_path):
    table = columns() | {"detector_signal": np.arange(50.0), "pixel": np.arange(50) % 2,
                         "backward": np.ones(50), "x_temperature_k": np.zeros(50)}
    recording, = read_axes(write(tmp_path / "scan.csv", table))
    assert np.array_equal(recording.signals["detector"], np.arange(50.0))
    assert np.array_equal(recording.marks, 8 + np.arange(50) % 2)
    assert set(recording.columns) == {"detector_signal", "pixel", "backward"}
    assert not read_axes(write(tmp_path / "plain.csv", columns()))[0].marks.size


def bag_of_axes(sample_blocks, path, samples=400, slow=False, names=("x", "y"),
                attachments=()):
    """Write a recording of a stage of two axes; return its voltages and displacements."""
    voltage_v, displacement_um = np.random.default_rng(4).uniform(0.0, 50.0, (2, samples, 2))
    playing = [sample_blocks.serialise(
        (40 if slow else 1) * first, voltage_v[first:first + 40], displacement_um[first:first + 40],
        1e-3 if slow else 2.5e-5, axes=names) for first in range(0, samples, 40)]
    rest = sample_blocks.serialise((40 if slow else 1) * samples, np.zeros((40, 2)),
                                   np.zeros((40, 2)), flags=0, axes=names)
    sample_blocks.write(path, {"/stage/samples": [*playing, rest]}, 40_000.0, attachments)
    return voltage_v, displacement_um


@pytest.mark.parametrize("inside", ["", "run_0.mcap"])
def test_recording_of_a_stage_is_read_to_the_bit(tmp_path, sample_blocks, inside):
    voltage_v, displacement_um = bag_of_axes(sample_blocks, tmp_path / "run")
    path = tmp_path / "run" / inside
    assert is_of_axes(path)
    recording, = read_axes(path)
    assert recording.axes == ("x", "y") and recording.sample_period_s == 2.5e-5
    assert np.array_equal(recording.voltage_v, voltage_v)
    assert np.array_equal(recording.displacement_um, displacement_um)


def test_samples_of_a_slow_waveform_are_taken_without_the_rest_behind_it(tmp_path, sample_blocks):
    voltage_v, _ = bag_of_axes(sample_blocks, tmp_path / "run", slow=True)
    recording, = read_axes(tmp_path / "run")
    assert recording.sample_period_s == 1e-3
    assert np.array_equal(recording.voltage_v, voltage_v)


def test_recording_of_several_axes_is_refused_by_name_where_one_is_wanted(tmp_path, sample_blocks):
    voltage_v, _ = bag_of_axes(sample_blocks, tmp_path / "run")
    with pytest.raises(RecordingError, match="run has the axes x, y, and one axis is wanted"):
        read_recording(tmp_path / "run")
    recording = read_recording(tmp_path / "run", several_axes=True)
    assert recording.voltage_v.shape == (440, 2) and len(recording.sample_index) == 440
    assert np.array_equal(recording.of_axis("y").voltage_v[:400], voltage_v[:, 1])
    with pytest.raises(RecordingError, match=r"as by of_axis\('x'\)\.plot"):
        recording.plot()
    assert list(recording.to_frame())[1:5] == [
        "x_voltage_v", "y_voltage_v", "x_displacement_um", "y_displacement_um"]


def test_recording_whose_axes_change_or_that_lacks_samples_is_refused(tmp_path, sample_blocks):
    blocks = [sample_blocks.serialise(40 * k, np.zeros((40, 2)), np.zeros((40, 2)), axes=names)
              for k, names in enumerate([("x", "y"), ("x", "z")])]
    sample_blocks.write(tmp_path / "other", {"/stage/samples": blocks})
    with pytest.raises(RecordingError, match="the names of the axes change"):
        read_axes(tmp_path / "other")
    sample_blocks.write(tmp_path / "gap", {"/stage/samples": [blocks[0], sample_blocks.serialise(
        200, np.zeros((40, 2)), np.zeros((40, 2)), axes=("x", "y"))]})
    with pytest.raises(RecordingError, match="gap has gaps: record it again"):
        read_axes(tmp_path / "gap")


def test_count_of_samples_of_several_axes_is_that_of_the_clock(sample_blocks):
    count = SampleCount(axes=2)
    for first in (0, 60):
        count.add(sample_blocks.serialise(first, np.zeros((40, 2)), np.zeros((40, 2)),
                                          axes=("x", "y")))
    assert (count.samples, count.missing, count.end) == (80, 20, 100)


@pytest.mark.parametrize(("told", "periods", "samples"), [
    (b'{"repeats": 5, "settling_repeats": 2}', 3, 240), (b'{"repeats": 5}', 0, 400),
    (b'{"repeats": 3, "settling_repeats": 1}', 0, 400), (b"[]", 0, 400), (b"damaged", 0, 400),
])
def test_periods_that_settled_are_taken_where_the_recording_tells_of_them(
        tmp_path, sample_blocks, told, periods, samples):
    voltage_v, _ = bag_of_axes(sample_blocks, tmp_path / "run",
                               attachments=[("parameters.json", told)])
    recording, = read_axes(tmp_path / "run")
    assert recording.periods == periods
    assert np.array_equal(recording.voltage_v, voltage_v[400 - samples:])
