# SPDX-License-Identifier: BSD-3-Clause
"""A recording is read where nothing of this suite and nothing of ROS is installed."""

import json
import os
import subprocess
import sysconfig
import venv
from importlib.metadata import distribution
from pathlib import Path

import numpy as np
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from piezo_recorder.sample_block import TYPE_NAME
from piezo_recorder.writing.message_definition import installed_definition
from piezo_recorder.writing.writer import RecordingWriter

PACKAGES = ["rosbags", "mcap", "numpy"]
READER = """
import importlib.util, json, sys
from pathlib import Path
import mcap.reader, numpy as np
from rosbags.highlevel import AnyReader

path = Path(sys.argv[1])
read = {"foreign": [name for name in ("piezo_recorder", "piezo_interfaces", "rclpy")
                    if importlib.util.find_spec(name)]}
with AnyReader([path]) as reader:
    blocks = [reader.deserialize(data, connection.msgtype)
              for connection, _, data in reader.messages()]
    read["topics"] = list(reader.topics)
read["first_sample"] = [int(block.first_sample) for block in blocks]
read["voltage_v"] = np.concatenate([block.voltage_v for block in blocks]).tolist()
read["displacement_um"] = np.concatenate([block.displacement_um for block in blocks]).tolist()
with open(path / f"{path.name}_0.mcap", "rb") as stream:
    reader = mcap.reader.make_reader(stream, validate_crcs=True)
    read["mcap_messages"] = [message.data.hex() for _, _, message in reader.iter_messages()]
    read["attachments"] = {each.name: each.data.decode() for each in reader.iter_attachments()}
print(json.dumps(read))
"""


@pytest.fixture
def clean_python(tmp_path):
    """Interpreter of an environment with the readers and what they need only, of this one."""
    environment = tmp_path / "environment"
    venv.create(environment, symlinks=True)
    packages = Path(sysconfig.get_path("purelib", vars={
        "base": environment, "platbase": environment}, scheme="venv"))
    for name in with_requirements(PACKAGES):
        for top in {file.parts[0] for file in distribution(name).files} - {"..", "__pycache__"}:
            if not (packages / top).exists():
                (packages / top).symlink_to(distribution(name).locate_file(top))
    return environment / "bin" / "python"


def with_requirements(names):
    """Names of distributions, and of all that they require here."""
    found, asked = set(), list(names)
    while asked:
        name = canonicalize_name(asked.pop())
        if name not in found:
            found.add(name)
            requirements = map(Requirement, distribution(name).requires or ())
            asked += [each.name for each in requirements
                      if each.marker is None or each.marker.evaluate({"extra": ""})]
    return found


def clean_variables():
    """Environment variables without any that bring in ROS or this suite."""
    own = ("PYTHON", "AMENT", "COLCON", "CMAKE", "ROS", "RMW", "_ROS", "LD_LIBRARY", "VIRTUAL_ENV")
    return {name: value for name, value in os.environ.items() if not name.startswith(own)}


def test_a_recording_is_read_without_any_package_of_ours(tmp_path, clean_python):
    definition = installed_definition(TYPE_NAME)
    typestore = get_typestore(Stores.EMPTY)
    typestore.register(get_types_from_msg(definition.text, TYPE_NAME))
    types = typestore.types
    generator = np.random.default_rng(0)
    voltage_v = generator.uniform(-20, 120, 1000)
    displacement_um = generator.uniform(0, 60, 1000)
    messages = []
    for first in range(0, 1000, 40):
        part = slice(first, first + 40)
        header = types["std_msgs/msg/Header"](
            types["builtin_interfaces/msg/Time"](0, 25_000 * first), "stage")
        messages.append(bytes(typestore.serialize_cdr(types[TYPE_NAME](
            header=header, first_sample=first, sample_period_s=2.5e-5, tick=first // 40 + 1,
            voltage_v=voltage_v[part], displacement_um=displacement_um[part], flags=16,
            missed_feedback=0, axes=[], marks=np.empty(0, np.uint8), signals=[],
            signal=np.empty(0)), TYPE_NAME)))
    with RecordingWriter(tmp_path / "run") as writer:
        writer.attach("model.json", b'{"format": "piezo_stage_model"}')
        channel = writer.add_topic("/stage/samples", definition)
        for number, message in enumerate(messages):
            writer.write(channel, message, number)

    output = subprocess.run(
        [clean_python, "-I", "-c", READER, writer.path], check=True, env=clean_variables(),
        cwd=tmp_path, stdout=subprocess.PIPE, text=True).stdout
    read = json.loads(output)
    assert read["foreign"] == []
    assert read["topics"] == ["/stage/samples"]
    assert read["first_sample"] == list(range(0, 1000, 40))
    assert read["voltage_v"] == voltage_v.tolist()
    assert read["displacement_um"] == displacement_um.tolist()
    assert read["mcap_messages"] == [message.hex() for message in messages]
    assert read["attachments"] == {"model.json": '{"format": "piezo_stage_model"}'}
