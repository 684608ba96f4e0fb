# SPDX-License-Identifier: BSD-3-Clause
"""What the middleware is told about signs of life, what got lost, who sends, and who waits."""

import os
import signal
import subprocess
import sys
from xml.etree import ElementTree

import pytest

import piezo_ros.discovery as discovery

FILES = (discovery.LOOPBACK, discovery.NETWORK)
NODE = ("from piezo_ros.discovery import prepare_discovery\n"
        "prepare_discovery()\n"
        "import rclpy\n"
        "rclpy.init()\n"
        "rclpy.create_node('reads_the_profiles')\n"
        "rclpy.shutdown()\n")
READER = """
from piezo_ros.discovery import prepare_discovery
prepare_discovery()
import rclpy
from std_msgs.msg import String
from piezo_ros.quality import SAMPLES
rclpy.init()
node = rclpy.create_node("reader", namespace="/held")
node.create_subscription(String, "samples", lambda message: None, SAMPLES)
rclpy.spin(node)
"""
# Publishes to a reader until it makes no room, and prints how many messages that were.
WRITER = """
import itertools, sys, time
from piezo_ros.discovery import holding_back, prepare_discovery
prepare_discovery()
import rclpy
from std_msgs.msg import String
from piezo_ros.quality import SAMPLES
rclpy.init()
with holding_back("samples", ["--ros-args", "-r", "__ns:=" + sys.argv[1]]):
    node = rclpy.create_node("writer", namespace="/held")
publisher = node.create_publisher(String, "samples", SAMPLES)
while not publisher.get_subscription_count():
    time.sleep(0.02)
print("matched", flush=True)
sys.stdin.readline()
for number in itertools.count():
    try:
        publisher.publish(String())
    except RuntimeError:
        break
print(number, flush=True)
"""


def seconds(profiles, name):
    entry, = (element for element in ElementTree.parse(profiles).iter()
              if element.tag.endswith("}" + name))
    return sum(float(part.text) * (1e-9 if part.tag.endswith("nanosec") else 1.0)
               for part in entry)


def told_by_the_middleware(profiles, **changes):
    environment = {**os.environ, discovery.PROFILES: str(profiles), **changes}
    return subprocess.run(
        [sys.executable, "-c", NODE], env=environment, check=True, text=True, timeout=300.0,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT).stdout


@pytest.mark.parametrize("profiles", FILES)
def test_times_are_those_that_the_suite_counts_on(profiles):
    assert seconds(profiles, "leaseDuration") == discovery.LEASE_S[profiles]
    assert seconds(profiles, "leaseAnnouncement") == discovery.ANNOUNCEMENT_S
    assert seconds(profiles, "heartbeatPeriod") == pytest.approx(discovery.RESENT_AFTER_S)


@pytest.mark.parametrize("profiles", FILES)
def test_the_middleware_takes_all_of_the_profiles(profiles):
    assert told_by_the_middleware(profiles) == ""


def test_the_middleware_says_where_it_takes_no_profile(tmp_path):
    wrong = tmp_path / "wrong.xml"
    wrong.write_text(discovery.LOOPBACK.read_text().replace("heartbeatPeriod", "heartbeatPeriode"))
    assert "heartbeatPeriode" in told_by_the_middleware(wrong)


def test_the_middleware_is_asked_to_send_by_a_thread_of_its_own(monkeypatch):
    monkeypatch.setattr(os, "environ", {**os.environ})
    os.environ.pop(discovery.PUBLICATION_MODE, None)
    discovery.deliver_in_background()
    mode = os.environ[discovery.PUBLICATION_MODE]
    # It says where it does not know what it is asked for.
    assert told_by_the_middleware(discovery.LOOPBACK, **{discovery.PUBLICATION_MODE: mode}) == ""
    unknown = {discovery.PUBLICATION_MODE: mode.lower()}
    assert "Using default SYNCHRONOUS" in told_by_the_middleware(discovery.LOOPBACK, **unknown)
    os.environ[discovery.PUBLICATION_MODE] = "SYNCHRONOUS"
    discovery.deliver_in_background()
    assert os.environ[discovery.PUBLICATION_MODE] == "SYNCHRONOUS"


@pytest.mark.parametrize(("namespace", "unacknowledged"), [
    ("/held", discovery.MOST_UNACKNOWLEDGED), ("/another", 5000)])
def test_writer_that_holds_back_waits_for_a_reader_after_few_messages(namespace, unacknowledged):
    reader = subprocess.Popen([sys.executable, "-c", READER])
    writer = subprocess.Popen([sys.executable, "-c", WRITER, namespace], text=True,
                              stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        assert writer.stdout.readline() == "matched\n"
        reader.send_signal(signal.SIGSTOP)
        print("publish", file=writer.stdin, flush=True)
        assert int(writer.stdout.readline()) == unacknowledged
    finally:
        for process in writer, reader:
            process.kill()
            process.wait()
        writer.stdin.close()
        writer.stdout.close()


def test_a_profile_of_the_user_stays_as_it_is(monkeypatch):
    monkeypatch.setenv(discovery.PROFILES, "/of/the/user.xml")
    with discovery.holding_back("samples", []):
        assert os.environ[discovery.PROFILES] == "/of/the/user.xml"
