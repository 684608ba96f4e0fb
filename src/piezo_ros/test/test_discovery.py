# SPDX-License-Identifier: BSD-3-Clause
"""What the middleware is told about signs of life and about what got lost."""

import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

import piezo_ros.discovery as discovery

PROFILES = Path(discovery.__file__).with_name("participant.xml")
NODE = ("from piezo_ros.discovery import prepare_discovery\n"
        "prepare_discovery()\n"
        "import rclpy\n"
        "rclpy.init()\n"
        "rclpy.create_node('reads_the_profiles')\n"
        "rclpy.shutdown()\n")


def seconds(name):
    entry, = (element for element in ElementTree.parse(PROFILES).iter()
              if element.tag.endswith("}" + name))
    return sum(float(part.text) * (1e-9 if part.tag.endswith("nanosec") else 1.0)
               for part in entry)


def told_by_the_middleware(profiles):
    environment = {**os.environ, discovery.PROFILES: str(profiles)}
    return subprocess.run(
        [sys.executable, "-c", NODE], env=environment, check=True, text=True, timeout=300.0,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT).stdout


def test_times_are_those_that_the_suite_counts_on():
    assert seconds("leaseDuration") == discovery.LEASE_S
    assert seconds("leaseAnnouncement") == discovery.ANNOUNCEMENT_S
    assert seconds("heartbeatPeriod") == pytest.approx(discovery.RESENT_AFTER_S)


def test_the_middleware_takes_all_of_the_profiles(tmp_path):
    assert told_by_the_middleware(PROFILES) == ""
    # It says where it does not, and then takes none of them.
    wrong = tmp_path / "wrong.xml"
    wrong.write_text(PROFILES.read_text().replace("heartbeatPeriod", "heartbeatPeriode"))
    assert "heartbeatPeriode" in told_by_the_middleware(wrong)
