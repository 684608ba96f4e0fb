# SPDX-License-Identifier: BSD-3-Clause
"""Count ended publishers until a node locks up, by lease: python ending_writers.py [SECONDS].

Three nodes listen while publishers come and go, beside participants whose leases they check. With
leases that are checked a hundred times as often as usual, the fault of Fast DDS that can lock up a
listening node for ever is met within a minute or two (docs/decisions/leases.md).
"""

import os
import random
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path

import rclpy
from rclpy.executors import SingleThreadedExecutor
from std_msgs.msg import String

from piezo_ros import discovery

LEASE = f"<leaseDuration><sec>{discovery.LEASE_S[discovery.LOOPBACK]:.0f}</sec></leaseDuration>"
OFTEN = "<leaseDuration><sec>0</sec><nanosec>20000000</nanosec></leaseDuration>"
PERIOD = "<nanosec>500000000</nanosec></leaseAnnouncement>"
SOON = "<nanosec>5000000</nanosec></leaseAnnouncement>"
LISTENERS, IDLE, TOPICS, SILENCE_S = 3, 8, 8, 4.0
LISTENER = """
import sys, rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("listener")
for number in range(8):
    node.create_subscription(String, f"topic_{number}", lambda message: None, 10)
alive = node.create_publisher(String, "alive", 1)
node.create_timer(0.2, lambda: alive.publish(String(data=sys.argv[1])))
rclpy.spin(node)
"""
BYSTANDER = "import rclpy; rclpy.init(); rclpy.spin(rclpy.create_node('bystander'))"


@contextmanager
def processes():
    """Run listeners and bystanders."""
    started = [subprocess.Popen([sys.executable, "-c", LISTENER, str(number)])
               for number in range(LISTENERS)]
    started += [subprocess.Popen([sys.executable, "-c", BYSTANDER]) for _ in range(IDLE)]
    try:
        yield
    finally:
        for process in started:
            process.kill()
            process.wait()


def publish_and_end(node):
    """Create publishers, publish once on each, and destroy them within some milliseconds."""
    publishers = [node.create_publisher(String, f"topic_{k}", 10) for k in range(TOPICS)]
    time.sleep(0.02)
    for publisher in publishers:
        publisher.publish(String(data="x" * 100))
    time.sleep(0.006 * random.random())
    for publisher in publishers:
        node.destroy_publisher(publisher)


def ended_until_silence(seconds):
    """Return how many publishers ended, and whether a listener fell silent for good."""
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("ending", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    heard_s = {}
    node.create_subscription(
        String, "alive", lambda message: heard_s.update({message.data: time.monotonic()}), 10)
    while len(heard_s) < LISTENERS:
        executor.spin_once(0.1)
    ended, end_s = 0, time.monotonic() + seconds
    while time.monotonic() < end_s:
        publish_and_end(node)
        ended += TOPICS
        for _ in range(2 * LISTENERS):
            executor.spin_once(0.0)
        if time.monotonic() - min(heard_s.values()) > SILENCE_S:
            return ended, True
    return ended, False


def main():
    """Print one line for each lease."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 120.0
    profile = discovery.LOOPBACK.read_text()
    often = profile.replace(LEASE, OFTEN).replace(PERIOD, SOON)
    for name, text in (("checked every 20 ms", often),
                       ("of the suite", profile.replace(PERIOD, SOON))):
        with tempfile.NamedTemporaryFile("w", suffix=".xml") as file:
            Path(file.name).write_text(text)
            os.environ.update({discovery.PROFILES: file.name, discovery.RANGE: "SYSTEM_DEFAULT"})
            command = [sys.executable, __file__, "--child", str(seconds)]
            with processes():
                subprocess.run(command, check=True, env={**os.environ, "LEASE": name})


if __name__ == "__main__":
    if "--child" in sys.argv:
        ended, locked_up = ended_until_silence(float(sys.argv[-1]))
        print(f"leases {os.environ['LEASE']}: {ended} publishers ended, "
              f"{'a listener locked up' if locked_up else 'no listener locked up'}", flush=True)
        os._exit(0)  # whatever else locked up
    main()
