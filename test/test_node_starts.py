# SPDX-License-Identifier: BSD-3-Clause
"""A node that is interrupted while it starts says one line and ends."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix

from piezo_bringup.processes import EXECUTABLES

TIMEOUT_S = 300.0
NODES = {**EXECUTABLES, "hardware": ("piezo_stage_driver", "stage")}
# What a process has loaded tells how far its start has come.
LOADED = ("numpy", "librcl.so", "libfastrtps")


def handles(pid, number):
    """Whether a process has a handler of its own for a signal."""
    caught = re.search(r"^SigCgt:\s*(\w+)$", Path(f"/proc/{pid}/status").read_text(), re.M)[1]
    return bool(int(caught, 16) >> (number - 1) & 1)


def wait_until(condition, process):
    deadline = time.monotonic() + TIMEOUT_S
    while not condition():
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < deadline, "the process does not get on"


def start(node, **changes):
    package, executable = NODES[node]
    environment = {**os.environ, **changes}
    environment.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None)  # of this process alone
    return subprocess.Popen([Path(get_package_prefix(package), "lib", package, executable)],
                            env=environment, stderr=subprocess.PIPE, text=True)


def interrupted(process, number, condition):
    """Interrupt a process once a condition holds; return its status and what it said."""
    with process:
        # Python itself handles SIGINT from its start on, and SIGTERM is ours alone.
        wait_until(lambda: handles(process.pid, signal.SIGTERM) and condition(), process)
        process.send_signal(number)
        _, said = process.communicate(timeout=TIMEOUT_S)
    return process.returncode, said


# All start by the same function.
@pytest.mark.parametrize(("node", "number"), [
    *((node, signal.SIGINT) for node in NODES), ("stage", signal.SIGTERM),
    *(pytest.param(node, signal.SIGTERM, marks=pytest.mark.long)
      for node in NODES if node != "stage")])
def test_interrupt_before_anything_is_loaded_is_one_line(node, number, tmp_path):
    # However late the signal comes, the node still loads its first library of ROS.
    (tmp_path / "rclpy.py").write_text("import time\ntime.sleep(1000.0)\n")
    path = os.pathsep.join([str(tmp_path), *sys.path])
    status, said = interrupted(start(node, PYTHONPATH=path), number, lambda: True)
    assert (status, said) == (130, f"{NODES[node][1]}: interrupted while it started\n")


@pytest.mark.parametrize("library", LOADED)
def test_interrupt_while_libraries_are_loaded_leaves_no_traceback(library):
    process = start("controller")
    maps = Path(f"/proc/{process.pid}/maps")
    status, said = interrupted(process, signal.SIGINT, lambda: library in maps.read_text())
    # Once the node is there it ends in order, as it does at any later time.
    assert status in (0, 130)
    assert "Traceback" not in said and "Exception" not in said
    assert said.count("\n") <= 1
