# SPDX-License-Identifier: BSD-3-Clause
import json

import pytest
from rosbags.typesys import get_types_from_msg

from piezo_recorder.writing.message_definition import installed_definition

OUTER = """# keeps its comments
uint32 LIMIT=3       # not/a_type
string<=10 name
Inner[<=2] pair      # of this package
other_msgs/Far far
float64[] values
"""


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Install two packages with messages as colcon does."""
    messages = {
        "some_msgs": {"Outer": OUTER, "Inner": "other_msgs/Far[2] both\n"},
        "other_msgs": {"Far": "int8 distance\n"},
    }
    for package, texts in messages.items():
        marker = tmp_path / "share/ament_index/resource_index/packages" / package
        marker.parent.mkdir(parents=True, exist_ok=True)
        marker.touch()
        folder = tmp_path / "share" / package / "msg"
        folder.mkdir(parents=True)
        for name, text in texts.items():
            (folder / f"{name}.msg").write_text(text, encoding="utf-8")
            hashes = [{"type_name": "x/msg/X", "hash_string": "RIHS01_other"},
                      {"type_name": f"{package}/msg/{name}", "hash_string": f"RIHS01_{name}"}]
            (folder / f"{name}.json").write_text(json.dumps({"type_hashes": hashes}))
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))


def test_the_definition_holds_every_type_used_once(installed):
    definition = installed_definition("some_msgs/msg/Outer")
    assert definition.text.startswith(OUTER)
    assert definition.text.count("MSG: ") == 2
    assert definition.type_hash == "RIHS01_Outer"
    assert set(get_types_from_msg(definition.text, "some_msgs/msg/Outer")) == {
        "some_msgs/msg/Outer", "some_msgs/msg/Inner", "other_msgs/msg/Far"}


@pytest.mark.parametrize(("type_name", "message"), [
    ("some_msgs/Outer", "write it as"),
    ("absent_msgs/msg/Outer", "'absent_msgs' of type .* is not installed"),
    ("some_msgs/msg/Absent", "'some_msgs' has no message 'Absent'"),
])
def test_a_type_that_is_not_there_is_named(installed, type_name, message):
    with pytest.raises(ValueError, match=message):
        installed_definition(type_name)
