# SPDX-License-Identifier: BSD-3-Clause
import os
import pickle
import signal
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from piezo_recorder.reader import RecordingError, read_recording
from piezo_recorder.writer import RecordingWriter

TOPIC = "/stage/samples"
# Writes a block a millisecond and tells when, until it is killed.
RECORDER = """
import pickle, sys, time
from piezo_recorder.writer import RecordingWriter
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


def test_a_kill_loses_at_most_one_second(tmp_path, sample_blocks):
    blocks = [sample_blocks.serialise(40 * k, np.full(40, k), np.full(40, -k))
              for k in range(20_000)]
    inputs = tmp_path / "inputs"
    inputs.write_bytes(pickle.dumps((sample_blocks.definition, blocks)))
    process = subprocess.Popen(
        [sys.executable, "-c", RECORDER, tmp_path / "run", inputs], stdout=subprocess.PIPE,
        text=True, env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)})
    written_at = []
    while len(written_at) < 1300:
        written_at.append(float(process.stdout.readline().split()[1]))
    process.send_signal(signal.SIGKILL)
    rest = [line.split() for line in process.stdout.read().splitlines()]
    process.wait()
    written_at += [float(line[1]) for line in rest if len(line) == 2]

    recording = read_recording(tmp_path / "run")
    assert not recording.complete
    assert recording.attachments == {"model.json": b"{}"}
    assert recording.gaps == []
    kept = len(recording.voltage_v) // 40
    assert np.array_equal(recording.voltage_v, np.repeat(np.arange(kept), 40))
    lost = written_at[kept:]
    assert kept > 0
    assert not lost or lost[-1] - lost[0] <= 1.0


@pytest.fixture(scope="module")
def closed_file(tmp_path_factory, sample_blocks):
    """Bytes of a recording with three chunks."""
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
