# SPDX-License-Identifier: BSD-3-Clause
"""A node that cannot start leaves ROS first; one that ends sends its last messages, and ends."""

import subprocess
import sys

import pytest

from piezo_ros.spinning import LAST_CALLBACKS

REFUSED = """
import atexit, os, sys
from pathlib import Path
from rclpy.lifecycle import LifecycleNode
from piezo_ros.parameters import declare
from piezo_ros.spinning import autostart, run_node

class Refused(LifecycleNode):
    def __init__(self):
        super().__init__("refused")
        {failure}

    def on_configure(self, state):
        raise RuntimeError("of the transition")

def tell():
    threads = [Path("/proc/self/task", task, "comm").read_text().strip()
               for task in os.listdir("/proc/self/task")]
    # It listens to the network in threads of these names as long as a participant lives.
    print([name for name in threads if name.startswith(("dds.udp", "dds.ev"))])

atexit.register(tell)
run_node(Refused, ["--ros-args", "-p", "rate_hz:=text"])
"""


@pytest.mark.parametrize(("failure", "line"), [
    ('declare(self, "rate_hz", 1.0, "Rate (Hz).")', "parameter rate_hz is no float"),
    ("autostart(self)", ""),
])
def test_refused_node_leaves_no_thread_of_the_middleware_behind(failure, line):
    ended = subprocess.run([sys.executable, "-c", REFUSED.format(failure=failure)],
                           capture_output=True, text=True, timeout=300)
    assert ended.returncode == 2
    assert line in ended.stderr
    assert "Traceback" not in ended.stderr
    assert ended.stdout.splitlines() == ["[]"]


CHAIN = """
from rclpy.node import Node
from piezo_ros import spinning

class Talkative(Node):
    left = spinning.LAST_CALLBACKS

    def __init__(self):
        super().__init__("talkative")

    def wind_down(self):
        self.speak()
        return True

    def speak(self):
        print(self.left)
        self.left -= 1
        if self.left:
            self.executor.create_task(self.speak)

spinning.LAST_WORDS_S = 0.0  # as on a computer that has no time for them
spinning.Ending.__bool__ = lambda ending: True
spinning.run_node(Talkative, [])
"""


def test_last_words_are_said_however_busy_the_computer_is():
    ended = subprocess.run([sys.executable, "-c", CHAIN], capture_output=True, text=True,
                           timeout=300)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.split() == [str(left) for left in range(LAST_CALLBACKS, 0, -1)]


BLOCKED = """
import ctypes
from rclpy.node import Node
from piezo_ros import spinning

class Blocked(Node):
    def __init__(self):
        super().__init__("blocked")

    def close(self):
        ctypes.PyDLL(None).pause()  # holds the interpreter, like a call of a blocked middleware

spinning.LONGEST_END_S = 0.5
spinning.Ending.__bool__ = lambda ending: True
spinning.run_node(Blocked, [])
"""


def test_node_whose_end_is_blocked_ends_and_prints_where():
    ended = subprocess.run([sys.executable, "-c", BLOCKED], capture_output=True, text=True,
                           timeout=300)
    assert ended.returncode == 1
    assert "in close" in ended.stderr
