# SPDX-License-Identifier: BSD-3-Clause
"""Nodes stay on this machine, and none starts without the security that it was asked for."""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix

from piezo_bringup.processes import EXECUTABLES, USUAL_NODES
from piezo_ros.discovery import (
    LOCALHOST_ONLY,
    LOOPBACK,
    MIDDLEWARE,
    NETWORK,
    PEERS,
    PROFILES,
    RANGE,
)

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


def prepared(**changes):
    """The environment of a process that has been prepared, which begins without a choice."""
    program = ("import json, os\n"
               "from piezo_ros.discovery import prepare_discovery\n"
               "prepare_discovery()\n"
               "print(json.dumps(dict(os.environ)))")
    unset = dict.fromkeys((RANGE, PEERS, LOCALHOST_ONLY, PROFILES, MIDDLEWARE))
    said = subprocess.run(["python3", "-c", program], capture_output=True, text=True, check=True,
                          env=environment(**{**unset, **changes})).stdout
    return json.loads(said)


@pytest.mark.parametrize(("given", "discovery_range", "profile"), [
    ({}, "SYSTEM_DEFAULT", LOOPBACK),
    ({RANGE: "LOCALHOST"}, "SYSTEM_DEFAULT", LOOPBACK),
    ({RANGE: "SUBNET", LOCALHOST_ONLY: "1"}, "SYSTEM_DEFAULT", LOOPBACK),
    ({RANGE: "SYSTEM_DEFAULT", PROFILES: str(LOOPBACK)}, "SYSTEM_DEFAULT", LOOPBACK),
    ({RANGE: "SYSTEM_DEFAULT"}, "SYSTEM_DEFAULT", NETWORK),
    ({RANGE: "SUBNET"}, "SUBNET", NETWORK),
    ({RANGE: "SUBNET", PROFILES: str(LOOPBACK)}, "SUBNET", NETWORK),
    ({PROFILES: "/of/the/user.xml"}, "LOCALHOST", "/of/the/user.xml"),
    ({PROFILES: "/of/the/user.xml", RANGE: "SUBNET"}, "SUBNET", "/of/the/user.xml"),
    ({MIDDLEWARE: "rmw_cyclonedds_cpp"}, "LOCALHOST", None),
])
def test_process_stays_on_this_machine_unless_the_environment_opens_it(
        given, discovery_range, profile):
    after = prepared(**given)
    assert after[RANGE] == discovery_range
    assert after.get(PROFILES) == (profile and str(profile))
    assert LOCALHOST_ONLY not in after


def udp_addresses(pid):
    """Addresses to which the UDP sockets of a process are bound."""
    sockets = set()
    for descriptor in Path(f"/proc/{pid}/fd").iterdir():
        try:
            sockets.add(descriptor.readlink().name)
        except OSError:  # closed meanwhile
            continue
    addresses = set()
    for table in "udp", "udp6":
        for line in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if f"socket:[{fields[9]}]" in sockets:
                addresses.add(fields[1].partition(":")[0])
    return addresses


def test_sockets_of_every_node_are_bound_to_the_loopback_alone(suite):
    """Nothing can come in by an address of the network, and nothing leave by one."""
    loopback = f"{int.from_bytes(socket.inet_aton('127.0.0.1'), sys.byteorder):08X}"
    pids = [suite.processes.process(node).pid for node in USUAL_NODES]
    assert {pid: udp_addresses(pid) for pid in [*pids, os.getpid()]} == dict.fromkeys(
        [*pids, os.getpid()], {loopback})


STRANGER = """
import sys, time
import rclpy
from std_srvs.srv import Trigger
from piezo_interfaces.msg import StageDescription
from rclpy.qos import DurabilityPolicy, QoSProfile
rclpy.init()
node = rclpy.create_node("stranger", namespace=sys.argv[1])
heard = []
node.create_subscription(StageDescription, "stage/description", heard.append, QoSProfile(
    depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
client = node.create_client(Trigger, "reset")
assert client.wait_for_service(120.0), "does not find the stage"
answer = client.call_async(Trigger.Request())
deadline = time.monotonic() + 120.0
while not (heard and answer.done()) and time.monotonic() < deadline:
    rclpy.spin_once(node, timeout_sec=0.1)
assert heard and answer.result().success
rclpy.shutdown()
"""


@pytest.mark.parametrize("discovery_range", ["LOCALHOST", "SUBNET"])
def test_node_without_the_profile_is_served_on_this_machine(suite, discovery_range):
    subprocess.run(
        [sys.executable, "-c", STRANGER, suite.node.get_namespace()], check=True,
        timeout=300, env=environment(**{RANGE: discovery_range, PROFILES: None}))


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
