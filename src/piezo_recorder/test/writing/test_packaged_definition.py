# SPDX-License-Identifier: BSD-3-Clause
"""Without ROS a recording embeds the same definition as with it."""

import pytest

from piezo_recorder.sample_block import TYPE_NAME
from piezo_recorder.writing import message_definition
from piezo_recorder.writing.message_definition import installed_definition


def test_definition_that_comes_with_the_package_is_the_installed_one(monkeypatch):
    installed = installed_definition(TYPE_NAME)
    monkeypatch.setattr(message_definition, "get_package_share_directory", None)
    assert installed_definition(TYPE_NAME) == installed


def test_other_types_are_refused_without_ros(monkeypatch):
    monkeypatch.setattr(message_definition, "get_package_share_directory", None)
    with pytest.raises(ValueError, match="needs ROS"):
        installed_definition("std_msgs/msg/Header")
