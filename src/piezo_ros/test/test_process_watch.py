# SPDX-License-Identifier: BSD-3-Clause
"""A process of this machine that dies or is suspended is missed long before its lease ends."""

import os
import signal
import subprocess
import sys
import time

import pytest
import rclpy

from piezo_ros import process_watch
from piezo_ros.discovery import LEASE_S, LOOPBACK, prepare_discovery
from piezo_ros.leaving import leave
from piezo_ros.process_watch import ProcessWatch

# Far below the lease, however busy the machine is.
TIMEOUT_S = LEASE_S[LOOPBACK] / 4.0
NODE = ("from piezo_ros.discovery import prepare_discovery\n"
        "prepare_discovery()\n"
        "import rclpy, sys\n"
        "rclpy.init()\n"
        "rclpy.spin(rclpy.create_node(sys.argv[1], namespace=sys.argv[2]))\n")


@pytest.fixture
def watcher():
    """A node beside which a watch runs."""
    prepare_discovery()
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("watcher", namespace="/watched", context=context)
    watch = ProcessWatch(node)
    yield node
    watch.end()
    leave(node)


@pytest.fixture
def processes():
    """Start processes, and end those that still run."""
    started = []

    def start(*command):
        started.append(subprocess.Popen(command))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.wait()


def until(condition):
    deadline = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < deadline, "it never happens"
        time.sleep(0.05)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_process_that_goes_away_is_missed_and_another_one_is_not(watcher, processes, number):
    def names():
        return {name for name, namespace in watcher.get_node_names_and_namespaces()
                if namespace == f"/watched_{number:d}"}

    victim = processes(sys.executable, "-c", NODE, "victim", f"/watched_{number:d}")
    processes(sys.executable, "-c", NODE, "bystander", f"/watched_{number:d}")
    until(lambda: names() == {"victim", "bystander"})
    time.sleep(2.0 * process_watch.PERIOD_S)  # the watch sees the victim alive
    victim.send_signal(number)
    until(lambda: "victim" not in names())
    assert names() == {"bystander"}


def test_process_that_comes_back_and_dies_at_once_is_missed_again(watcher, processes):
    def is_seen():
        return any(int.from_bytes(prefix[4:6], "little") == victim.pid % (1 << 16)
                   for prefix in process_watch._participants(watcher))

    victim = processes(sys.executable, "-c", NODE, "returning", "/watched")
    until(is_seen)
    time.sleep(2.0 * process_watch.PERIOD_S)
    victim.send_signal(signal.SIGSTOP)
    until(lambda: not is_seen())
    victim.send_signal(signal.SIGCONT)
    until(is_seen)
    victim.kill()
    until(lambda: not is_seen())


def process_of(number):
    prefix = bytes([1, 15, 0, 0]) + (number % (1 << 16)).to_bytes(2, "little") + bytes(6)
    found, = (process for process in process_watch._processes_of(prefix)
              if process.number == number)
    return found


def test_process_is_lost_once_it_ended_or_stood_still_for_long(processes):
    sleeper = processes("sleep", "1000")
    process = process_of(sleeper.pid)
    assert not process.is_lost()
    sleeper.send_signal(signal.SIGSTOP)
    until(lambda: process_watch._state_of(sleeper.pid)[0] == "T")
    assert not any([process.is_lost() for _ in range(process_watch.MISSED_LOOKS)])
    assert process.is_lost()
    sleeper.send_signal(signal.SIGCONT)
    until(lambda: process_watch._state_of(sleeper.pid)[0] != "T")
    assert not process.is_lost()
    sleeper.kill()
    until(process.is_lost)
    sleeper.wait()
    assert process.is_lost()


def test_another_process_of_the_same_number_does_not_stand_for_the_one_that_ended():
    process = process_of(os.getpid())
    assert not process.is_lost()
    process.started = "0"
    assert not any([process.is_lost() for _ in range(process_watch.MISSED_LOOKS)])
    assert process.is_lost()


def test_without_the_transport_of_this_machine_nothing_is_watched(watcher, monkeypatch):
    monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", "/profile/of/another.xml")
    watch = ProcessWatch(watcher)
    assert not watch._thread.is_alive()
    watch.end()
