# SPDX-License-Identifier: BSD-3-Clause
"""Compare the loopback with shared memory, side by side: python transports.py [ROUNDS].

Each round runs the same suite over both: round trips of a tick, a run answered by messages, a run
on board, a feedforward of a million samples, and the nodes while nothing happens.
"""

import array
import os
import random
import sys
import tempfile
import time
from collections import defaultdict
from contextlib import contextmanager
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from loop_speed import REFERENCE, ping_pong_round_trips
from piezo_interfaces.srv import LoadFeedforward
from stage_model import write_model

from piezo_bringup.processes import Processes
from piezo_client.client import Client
from piezo_ros import discovery

NODES = ("stage", "recorder", "controller")
LARGE = array.array("d", 10.0 - 10.0 * np.cos(np.linspace(0.0, 2.0 * np.pi, 1_000_001)[:-1]))
LARGE_AT_A_TIME, IDLE_S, TRACKED_S, ROUND_TRIPS = 5, 5.0, 10.0, 3000
NAMESPACE = "{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}"
OF_THE_LOOPBACK = ("userTransports", "useBuiltinTransports", "metatrafficUnicastLocatorList",
                   "initialPeersList", "transport_descriptors")
# Of a kernel as it comes, 208 KiB; the suite asks for more, where the kernel grants it.
USUAL_BUFFER = "212992"


def loopback(directory):
    """Return the environment of the suite's own transport."""
    return {discovery.PROFILES: str(discovery.LOOPBACK), discovery.RANGE: "SYSTEM_DEFAULT"}


def small_buffers(directory):
    """Return the environment of the suite's transport where the kernel grants no larger buffers."""
    document = ElementTree.parse(discovery.LOOPBACK)
    for name in "sendBufferSize", "receiveBufferSize":
        for element in document.iter(NAMESPACE + name):
            element.text = USUAL_BUFFER
    return _environment(directory, document, "SYSTEM_DEFAULT")


def shared_memory(directory):
    """Return the environment of the middleware's own choice, with the same times."""
    document = ElementTree.parse(discovery.LOOPBACK)
    for parent in list(document.iter()):
        for element in [*parent]:
            if element.tag.removeprefix(NAMESPACE) in OF_THE_LOOPBACK:
                parent.remove(element)
    return _environment(directory, document, "LOCALHOST")


def _environment(directory, document, discovery_range):
    ElementTree.register_namespace("", NAMESPACE.strip("{}"))
    file = directory / "profile.xml"
    document.write(file, encoding="utf-8", xml_declaration=True)
    return {discovery.PROFILES: str(file), discovery.RANGE: discovery_range}


TRANSPORTS = {"loopback": loopback, "loopback, usual buffers": small_buffers,
              "shared memory": shared_memory}


@contextmanager
def environment(values):
    """Set environment variables for what is begun meanwhile."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


def processor_s(processes):
    """Processor time that the nodes have taken so far (s)."""
    ticks = 0
    for name in NODES:
        fields = Path(f"/proc/{processes.process(name).pid}/stat").read_text().rpartition(")")[2]
        ticks += sum(map(int, fields.split()[11:13]))
    return ticks / os.sysconf("SC_CLK_TCK")


def memory_mb(processes):
    """Memory of the nodes, what they share counted in parts (MB)."""
    total_kb = 0
    for name in NODES:
        lines = Path(f"/proc/{processes.process(name).pid}/smaps_rollup").read_text().splitlines()
        total_kb += next(int(line.split()[1]) for line in lines if line.startswith("Pss:"))
    return total_kb / 1024


def measure(directory):
    """Return figures by name, of the transport that the environment says."""
    trips_us = 1e6 * ping_pong_round_trips(directory / "ping", ROUND_TRIPS)
    figures = {f"round trip of a tick, p{percent} (us)": np.percentile(trips_us, percent)
               for percent in (50, 99)}
    write_model(directory / "model.json")
    with Processes(directory / "logs", data_root=directory) as processes, Client() as client:
        processes.start("stage", {"autostart": True, "timing": "lockstep"})
        processes.start("recorder")
        for feedback, what in (("remote", "answered by messages"), ("onboard", "on board")):
            processes.start("controller", {"feedback": feedback})
            client.spin_until(lambda: set(NODES) <= set(client.node.get_node_names()), 60.0)
            for duration_s in (0.1, TRACKED_S):  # the first compiles
                begun_s, used_s = time.monotonic(), processor_s(processes)
                client.track(REFERENCE, directory / "model.json", "composite", duration_s,
                             directory / feedback)
            figures[f"run {what}, recorded (simulated s per s)"] = (
                TRACKED_S / (time.monotonic() - begun_s))
            figures[f"run {what}, processor (s per simulated s)"] = (
                (processor_s(processes) - used_s) / TRACKED_S)
            if feedback == "remote":
                processes.stop(["controller"])
        taken_s = []
        for _ in range(LARGE_AT_A_TIME):
            begun_s = time.monotonic()
            loaded = client.call(LoadFeedforward, "load_feedforward", period_voltage_v=LARGE)
            taken_s.append(time.monotonic() - begun_s)
            assert loaded.success, loaded.message
        figures["feedforward of a million samples, until it is loaded (s)"] = np.median(taken_s)
        used_s = processor_s(processes)
        client.spin_until(lambda: False, IDLE_S)
        figures["three nodes idle, processor (% of a core)"] = (
            100.0 * (processor_s(processes) - used_s) / IDLE_S)
        figures["three nodes, memory (MB)"] = memory_mb(processes)
    return figures


def main():
    """Print the medians."""
    rounds = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    os.environ["ROS_DOMAIN_ID"] = str(random.Random().randint(1, 100))
    rows = defaultdict(lambda: defaultdict(list))
    for _ in range(rounds):
        for name, prepare in TRANSPORTS.items():
            with tempfile.TemporaryDirectory() as folder:
                with environment(prepare(Path(folder))):
                    for figure, value in measure(Path(folder)).items():
                        rows[figure][name].append(value)
                        print(f"{name}: {figure} {value:.3g}", file=sys.stderr, flush=True)
    print(f"| median of {rounds} | {' | '.join(TRANSPORTS)} |\n|---|{'---|' * len(TRANSPORTS)}")
    for figure, values in rows.items():
        medians = (f"{np.median(values[name]):.3g}" for name in TRANSPORTS)
        print(f"| {figure} | {' | '.join(medians)} |")


if __name__ == "__main__":
    main()
