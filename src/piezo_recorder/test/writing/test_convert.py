# SPDX-License-Identifier: BSD-3-Clause
"""What `convert` writes is read back as it was."""

from dataclasses import replace

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from piezo_recorder.commands.convert_command import main as convert_main
from piezo_recorder.reading.axes import read_axes
from piezo_recorder.reading.reader import read_recording
from piezo_recorder.writing import convert
from piezo_recorder.writing.message_definition import MessageDefinition


@pytest.fixture(autouse=True)
def definition(monkeypatch, sample_blocks):
    """Types of the messages without an installation of them."""
    def found(type_name) -> MessageDefinition:
        return sample_blocks.definition

    monkeypatch.setattr(convert, "installed_definition", found)


@pytest.fixture
def table(tmp_path):
    """A table of another program with a gap and a further column."""
    kept = np.r_[0:5000, 6000:9000]
    path = tmp_path / "table.txt"
    random = np.random.default_rng(5)
    np.savetxt(path, np.column_stack([
        4.0 + 0.25 * kept, random.uniform(-20, 120, kept.size), random.normal(size=kept.size),
        kept % 3]), delimiter=";", header="t [ms];U [V];x [nm];temperature", comments="")
    return path


@pytest.mark.parametrize("name", ["new.csv", "new"])
def test_converted_recording_is_read_back_as_it_was(tmp_path, table, name, capsys):
    assert convert_main([str(table), str(tmp_path / name)]) == 0
    said = capsys.readouterr().out
    assert "1 gap" in said
    assert f"8000 samples written to {tmp_path / name}" in said
    before, after = read_recording(table), read_recording(tmp_path / name)
    np.testing.assert_array_equal(after.voltage_v, before.voltage_v)
    np.testing.assert_array_equal(after.displacement_um, before.displacement_um)
    np.testing.assert_array_equal(after.sample_index, before.sample_index)
    assert after.gaps == before.gaps == [(5000, 1000)]
    assert after.sample_period_s == pytest.approx(250e-6)
    if name.endswith(".csv"):
        np.testing.assert_array_equal(after.columns["temperature"], before.columns["temperature"])
    else:
        assert "not written: temperature" in said
        assert b"sha256" in after.attachments["conversion.json"]


@pytest.mark.parametrize("name", ["new.csv", "new"])
def test_converted_recording_of_two_axes_is_read_back_as_it_was(
        tmp_path, sample_blocks, name, capsys):
    voltage_v, displacement_um = np.random.default_rng(6).uniform(0.0, 50.0, (2, 120, 2))
    sample_blocks.write(tmp_path / "run", {"/stage/samples": [sample_blocks.serialise(
        first, voltage_v[first:first + 40], displacement_um[first:first + 40], axes=("x", "y"),
        marks=np.arange(first, first + 40) % 16, signals=["camera"], signal=voltage_v[:40, 0])
        for first in range(0, 120, 40)]}, 40_000.0)
    assert convert_main([str(tmp_path / "run"), str(tmp_path / name)]) == 0
    assert "not written" not in capsys.readouterr().out
    recording, = read_axes(tmp_path / name)
    assert recording.axes == ("x", "y")
    np.testing.assert_array_equal(recording.marks, np.arange(120) % 16)
    np.testing.assert_array_equal(recording.signals["camera"], np.tile(voltage_v[:40, 0], 3))
    np.testing.assert_array_equal(recording.voltage_v, voltage_v)
    np.testing.assert_array_equal(recording.displacement_um, displacement_um)


def test_blocks_end_where_the_period_or_the_flags_change_and_nowhere_else(tmp_path, table):
    strides, flags = np.repeat([2, 1], [60, 40]), np.repeat([0, 1, 0, 1], [30, 50, 19, 1])
    count = len(strides)
    recording = replace(
        read_recording(table), columns={}, sample_rate_hz=4000.0, flags=flags.astype(np.uint32),
        sample_index=np.cumsum(strides) - strides, sample_periods_s=strides / 4000.0,
        voltage_v=np.zeros(count), displacement_um=np.zeros(count))
    convert.write_recording(recording, tmp_path / "new")
    with AnyReader([tmp_path / "new"]) as reader:
        blocks = [reader.deserialize(data, connection.msgtype)
                  for connection, _, data in reader.messages()]
    assert [(block.first_sample, len(block.voltage_v), block.flags) for block in blocks] == [
        (0, 30, 0), (60, 30, 1), (120, 20, 1), (140, 19, 0), (159, 1, 1)]
    assert {block.missed_feedback for block in blocks} == {0}


def test_each_of_several_recordings_is_written_under_its_title(tmp_path, capsys):
    path = tmp_path / "runs.csv"
    rows = "".join(f"{run};{t};{t * run};{t}\n" for run in (1, 7) for t in range(30))
    path.write_text("run;t [s];U [V];x [um]\n" + rows)
    assert convert_main([str(path), str(tmp_path / "one.csv"), "--columns", "recording=run"]) == 0
    assert read_recording(tmp_path / "one_7.csv").voltage_v[-1] == 7 * 29
    assert not (tmp_path / "one.csv").exists()


@pytest.mark.parametrize("output, said", [
    ("table.txt", "exists already"), ("nowhere/new.csv", "in no existing directory")])
def test_output_that_cannot_be_made_is_refused_in_one_line(tmp_path, table, output, said, capsys):
    assert convert_main([str(table), str(tmp_path / output)]) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1
