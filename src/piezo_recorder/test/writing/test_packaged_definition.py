# SPDX-License-Identifier: BSD-3-Clause
"""Without ROS a recording embeds the same definition as with it."""

import pytest

from piezo_recorder.sample_block import TYPE_NAME
from piezo_recorder.writing import message_definition
from piezo_recorder.writing.message_definition import installed_definition


@pytest.fixture
def without_ros(monkeypatch):
    def refuse(package):
        raise message_definition.PackageNotFoundError(package)

    return lambda: monkeypatch.setattr(message_definition, "get_package_share_directory", refuse)


def test_definition_that_comes_with_the_package_is_the_installed_one(without_ros):
    installed = installed_definition(TYPE_NAME)
    without_ros()
    assert installed_definition(TYPE_NAME) == installed


def test_other_types_are_refused_without_ros(without_ros):
    without_ros()
    with pytest.raises(ValueError, match="is not installed"):
        installed_definition("std_msgs/msg/Header")
