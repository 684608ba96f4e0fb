# SPDX-License-Identifier: BSD-3-Clause
import os
import pickle
import random
import signal
import subprocess
import sys

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from piezo_recorder.commands.repair_command import main as repair_command
from piezo_recorder.commands.report_command import main as report_command
from piezo_recorder.reading.reader import read_recording
from piezo_recorder.reading.recording import RecordingError
from piezo_recorder.writing.writer import RecordingWriter

TOPIC = "/stage/samples"
KILLS = 50 if os.environ.get("LONG_TESTS") else 3
# Writes a block a millisecond and tells when, until it is killed.
RECORDER = """
import pickle, sys, time
from piezo_recorder.writing.writer import RecordingWriter
path, inputs = sys.argv[1:]
definition, blocks = pickle.load(open(inputs, "rb"))
writer = RecordingWriter(path)
writer.attach("model.json", b"{}")
channel = writer.add_topic("/stage/samples", definition)
for number, data in enumerate(blocks):
    writer.write(channel, data, number)
    print(number, time.monotonic(), flush=True)
    time.sleep(0.001)
"""


def kill_a_recorder(directory, inputs, messages):
    """Kill a recorder after some messages; return when it wrote each one."""
    process = subprocess.Popen(
        [sys.executable, "-c", RECORDER, directory, inputs], stdout=subprocess.PIPE,
        text=True, env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)})
    told = [process.stdout.readline() for _ in range(messages)]
    process.send_signal(signal.SIGKILL)
    lines = [line.split() for line in [*told, *process.stdout.read().splitlines()]]
    process.wait()
    return [float(line[1]) for line in lines if len(line) == 2]


@pytest.fixture(scope="module")
def inputs(tmp_path_factory, sample_blocks):
    """Return twenty seconds of blocks, a millisecond each, and what they are of."""
    blocks = [sample_blocks.serialise(40 * k, np.full(40, k), np.full(40, -k))
              for k in range(20_000)]
    path = tmp_path_factory.mktemp("killed") / "inputs"
    path.write_bytes(pickle.dumps((sample_blocks.definition, blocks)))
    return path


@pytest.mark.parametrize("kill", range(KILLS))
def test_a_kill_at_any_moment_loses_at_most_one_second(tmp_path, inputs, kill):
    # A message takes a millisecond at least: the first kill is surely after a second.
    messages = random.Random(kill).randint(1, 2000) if kill else 1300
    written_at = kill_a_recorder(tmp_path / "run", inputs, messages)
    try:
        recording = read_recording(tmp_path / "run")
        kept = len(recording.voltage_v) // 40
    except RecordingError as error:
        assert "holds no samples" in str(error) or "has no topic of samples" in str(error)
        kept = 0
    lost = written_at[kept:]
    assert not lost or lost[-1] - lost[0] <= 1.0
    if kept:
        assert not recording.complete
        assert recording.attachments == {"model.json": b"{}"}
        assert recording.gaps == []
        assert np.array_equal(recording.voltage_v, np.repeat(np.arange(kept), 40))

    # The one line of repair, and what other readers say then.
    assert repair_command([str(tmp_path / "run"), str(tmp_path / "mended")]) == 0
    with AnyReader([tmp_path / "mended"]) as reader:
        assert reader.message_count == kept
        assert len([1 for _ in reader.messages()]) == kept
    with open(tmp_path / "mended" / "mended_0.mcap", "rb") as stream:
        summary = make_reader(stream).get_summary()
        assert summary.statistics.message_count == kept
    if kept:
        mended = read_recording(tmp_path / "mended")
        assert mended.complete
        assert np.array_equal(mended.voltage_v, recording.voltage_v)
        assert mended.attachments == recording.attachments


def test_repair_overwrites_nothing_and_refuses_what_is_no_recording(tmp_path, closed_file, capsys):
    path = tmp_path / "whole.mcap"
    path.write_bytes(closed_file[0])
    (tmp_path / "there").mkdir()
    assert repair_command([str(path), str(tmp_path / "there")]) == 2
    assert "exists already" in capsys.readouterr().err
    assert repair_command([str(tmp_path / "none"), str(tmp_path / "new")]) == 2
    assert "does not exist" in capsys.readouterr().err
    path.write_bytes(b"no recording")
    assert repair_command([str(path), str(tmp_path / "new")]) == 2
    assert "damaged or no MCAP file" in capsys.readouterr().err


def test_repair_copies_every_file_of_a_recording(tmp_path, sample_blocks):
    blocks = [sample_blocks.serialise(40 * k, np.full(40, k), np.zeros(40)) for k in range(4)]
    truth = "/stage/ground_truth"
    # The topics are numbered in another order in the second file.
    path = sample_blocks.write(tmp_path / "split", {TOPIC: blocks[:2], truth: blocks[:1]})
    other = sample_blocks.write(tmp_path / "other", {truth: blocks[1:2], TOPIC: blocks[2:]})
    (other / "other_0.mcap").rename(path / "split_1.mcap")
    metadata = yaml.safe_load((path / "metadata.yaml").read_text(encoding="utf-8"))
    metadata["rosbag2_bagfile_information"]["relative_file_paths"].append("split_1.mcap")
    (path / "metadata.yaml").write_text(yaml.safe_dump(metadata), encoding="utf-8")
    assert repair_command([str(path), str(tmp_path / "mended")]) == 0
    mended = read_recording(tmp_path / "mended", topic="samples")
    assert np.array_equal(mended.voltage_v, np.repeat(np.arange(4.0), 40))
    truth = read_recording(tmp_path / "mended", topic="ground_truth")
    assert np.array_equal(truth.voltage_v, np.repeat([0.0, 1.0], 40))


def test_report_accounts_for_every_sample(tmp_path, sample_blocks, capsys):
    blocks = [sample_blocks.serialise(40 * k, np.zeros(40), np.zeros(40)) for k in (0, 1, 4, 5)]
    path = sample_blocks.write(tmp_path / "gap", {TOPIC: blocks})
    assert report_command([str(path)]) == 1
    said = capsys.readouterr().out
    assert "160 samples, index 0 to 239" in said
    assert "error: 80 samples are missing from sample 80 on" in said
    path = sample_blocks.write(tmp_path / "whole", {TOPIC: blocks[:2]})
    assert report_command([str(path)]) == 0
    assert "error" not in capsys.readouterr().out
    assert report_command([str(tmp_path / "none")]) == 2


@pytest.fixture(scope="module")
def closed_file(tmp_path_factory, sample_blocks):
    """Return the bytes of a recording with three chunks."""
    path = tmp_path_factory.mktemp("closed") / "run"
    with RecordingWriter(path) as writer:
        writer.attach("model.json", b"{}")
        channel = writer.add_topic(TOPIC, sample_blocks.definition)
        for k in range(9):
            voltage_v = np.random.default_rng(k).uniform(0, 1, 40)
            writer.write(channel, sample_blocks.serialise(40 * k, voltage_v, voltage_v), k)
            if k % 3 == 2:
                writer.flush()
    return (path / "run_0.mcap").read_bytes(), read_recording(path).voltage_v


@settings(deadline=None)
@given(data=st.data())
def test_a_file_cut_anywhere_gives_what_came_before_or_a_clear_error(
        tmp_path_factory, closed_file, data):
    content, voltage_v = closed_file
    path = tmp_path_factory.getbasetemp() / "cut.mcap"
    path.write_bytes(content[:data.draw(st.integers(0, len(content) - 1))])
    try:
        recording = read_recording(path)
    except RecordingError:
        return
    samples = len(recording.voltage_v)
    assert samples in (120, 240, 360)
    assert np.array_equal(recording.voltage_v, voltage_v[:samples])
    assert recording.complete is False or samples == 360


def test_a_damaged_file_is_refused(tmp_path, closed_file):
    content = bytearray(closed_file[0])
    content[len(content) // 2] ^= 0xFF
    path = tmp_path / "damaged.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match="is damaged"):
        read_recording(path)


def test_zeros_that_a_power_failure_left_at_the_end_are_no_records(tmp_path, closed_file):
    content, voltage_v = closed_file
    path = tmp_path / "run.mcap"
    path.write_bytes(content[:-60] + bytes(100_000))
    recording = read_recording(path)
    assert not recording.complete and np.array_equal(recording.voltage_v, voltage_v)
