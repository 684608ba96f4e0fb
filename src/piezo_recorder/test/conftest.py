# SPDX-License-Identifier: BSD-3-Clause
"""Sample blocks as a stage sends them, made without ROS."""

import json
import resource
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from piezo_recorder.reading.tables import matlab_contents, matlab_files
from piezo_recorder.sample_block import TYPE_NAME, Flag
from piezo_recorder.writing.message_definition import MessageDefinition
from piezo_recorder.writing.writer import RecordingWriter

MESSAGE_FILE = Path(__file__).parents[2] / "piezo_interfaces" / "msg" / "SampleBlock.msg"


class SampleBlocks:
    """Serialise sample blocks and write recordings of them."""

    def __init__(self):
        self.typestore = get_typestore(Stores.ROS2_JAZZY)
        self.typestore.register(
            get_types_from_msg(MESSAGE_FILE.read_text(encoding="utf-8"), TYPE_NAME))
        text, _ = self.typestore.generate_msgdef(TYPE_NAME, ros_version=2)
        self.definition = MessageDefinition(
            TYPE_NAME, text, self.typestore.hash_rihs01(TYPE_NAME))

    def serialise(self, first_sample, voltage_v, displacement_um, sample_period_s=2.5e-5,
                  flags=Flag.PLAYING, frame_id="stage", axes=(), marks=(), signals=(), signal=()):
        types = self.typestore.types
        stamp = types["builtin_interfaces/msg/Time"](0, 0)
        header = types["std_msgs/msg/Header"](stamp, frame_id)
        block = types[TYPE_NAME](
            header=header, first_sample=first_sample, sample_period_s=sample_period_s,
            tick=first_sample // 40, voltage_v=np.ravel(voltage_v).astype(float),
            displacement_um=np.ravel(displacement_um).astype(float), flags=int(flags),
            missed_feedback=0, axes=list(axes), marks=np.array(marks, np.uint8),
            signals=list(signals), signal=np.ravel(signal).astype(float))
        return bytes(self.typestore.serialize_cdr(block, TYPE_NAME))

    def write(self, path, topics, sample_rate_hz=None, attachments=()):
        """Write a recording; ``topics`` maps a topic to its serialised blocks."""
        with RecordingWriter(path, sample_rate_hz) as writer:
            for name, content in attachments:
                writer.attach(name, content)
            for topic, blocks in topics.items():
                channel = writer.add_topic(topic, self.definition)
                for number, data in enumerate(blocks):
                    writer.write(channel, data, 1_000_000 * number)
        return path


@pytest.fixture
def matlab_in_place(monkeypatch):
    """Read MATLAB files in this process: its own takes most of the time of a sound small file."""
    def read(path, target):
        with redirect_stdout(StringIO()) as printed:
            matlab_contents.main(str(path), str(target), str(resource.RLIM_INFINITY))
        return json.loads(printed.getvalue())

    monkeypatch.setattr(matlab_contents.resource, "setrlimit", lambda *_: None)
    monkeypatch.setattr(matlab_files, "_read_apart", read)


@pytest.fixture(scope="session")
def sample_blocks():
    return SampleBlocks()


@pytest.fixture
def ten_blocks(sample_blocks):
    """Return ten contiguous blocks of 40 samples, serialised, their voltages and displacements."""
    generator = np.random.default_rng(1)
    voltage_v = generator.uniform(-20, 120, 400)
    displacement_um = generator.uniform(0, 60, 400)
    blocks = [
        sample_blocks.serialise(40 * k, voltage_v[40 * k:40 * k + 40],
                                displacement_um[40 * k:40 * k + 40])
        for k in range(10)]
    return blocks, voltage_v, displacement_um
