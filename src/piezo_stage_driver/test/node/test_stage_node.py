# SPDX-License-Identifier: BSD-3-Clause
"""A stage is started so that no reader keeps the ticks of a paced one waiting."""

import os

import pytest

from piezo_ros.discovery import PUBLICATION_MODE
from piezo_stage_driver.node import stage_node


@pytest.mark.parametrize(("arguments", "mode"), [
    (["stage"], "ASYNCHRONOUS"),
    (["stage", "--ros-args", "-p", "timing:=paced"], "ASYNCHRONOUS"),
    (["stage", "--ros-args", "-p", "timing:=lockstep"], None)])
def test_who_delivers_is_chosen_before_ros_starts(arguments, mode, monkeypatch):
    monkeypatch.setattr(os, "environ", {**os.environ})
    os.environ.pop(PUBLICATION_MODE, None)
    started = []
    monkeypatch.setattr(stage_node, "run_node", lambda create_node, args, **_: started.append(
        (args, os.environ.get(PUBLICATION_MODE))))
    stage_node.main(arguments)
    assert started == [(arguments, mode)]
