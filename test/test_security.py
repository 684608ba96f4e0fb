# SPDX-License-Identifier: BSD-3-Clause
"""Nodes stay on this machine, and none starts without the security that it was asked for."""

import os
import subprocess
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix

from piezo_bringup.processes import EXECUTABLES

ENCLAVE_FILES = ("identity_ca.cert.pem", "cert.pem", "key.pem", "permissions_ca.cert.pem",
                 "governance.p7s", "permissions.p7s")
LAUNCH = Path(__file__).parents[1] / "src" / "piezo_bringup" / "launch" / "stage.launch.py"


def environment(**changes):
    environment = {**os.environ, **changes}
    environment.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None)  # of this process alone
    return {name: value for name, value in environment.items() if value is not None}


def executable(node):
    package, name = EXECUTABLES[node]
    return Path(get_package_prefix(package), "lib", package, name)


@pytest.mark.parametrize(("given", "used"), [(None, "LOCALHOST"), ("SUBNET", "SUBNET")])
def test_discovery_stays_on_this_machine_unless_the_environment_opens_it(given, used):
    program = ("import os\n"
               "from piezo_ros.discovery import prepare_discovery\n"
               "prepare_discovery()\n"
               "print(os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'])")
    said = subprocess.run(["python3", "-c", program], capture_output=True, text=True, check=True,
                          env=environment(ROS_AUTOMATIC_DISCOVERY_RANGE=given)).stdout
    assert said.strip() == used



def test_launch_file_keeps_discovery_here_and_has_an_argument_that_opens_it():
    text = LAUNCH.read_text()
    assert '"discovery_range", default_value="LOCALHOST"' in text
    assert '"ROS_AUTOMATIC_DISCOVERY_RANGE", LaunchConfiguration("discovery_range")' in text


# All start by the same function; those that load the numerics first take seconds.
@pytest.mark.parametrize("node", [
    "stage", "recorder", *(pytest.param(node, marks=pytest.mark.long)
                           for node in EXECUTABLES if node not in ("stage", "recorder"))])
def test_node_that_is_asked_for_security_does_not_start_without_it(node, tmp_path):
    enclave = tmp_path / "enclaves" / "mine"
    enclave.mkdir(parents=True)
    for name in ENCLAVE_FILES:
        (enclave / name).write_text("not signed by anybody")
    ended = subprocess.run(
        [executable(node), "--ros-args", "--enclave", "/mine"], capture_output=True, text=True,
        timeout=300, env=environment(ROS_SECURITY_ENABLE="true", ROS_SECURITY_STRATEGY="Enforce",
                                     ROS_SECURITY_KEYSTORE=str(tmp_path)))
    assert ended.returncode == 2
    assert "Traceback" not in ended.stderr
    # With the wheels because the plugins are missing, elsewhere because the files are worthless.
    assert "error creating node: " in ended.stderr
    if "ROS_DISTRO" not in os.environ:
        assert "doesn't have the security libraries" in ended.stderr
