# SPDX-License-Identifier: BSD-3-Clause
"""Announce processes that ended without a word, so that others do not wait for their lease.

The middleware would detect them itself by a lease of liveliness, but each check of a lease can lock
up its process for ever (docs/decisions/leases.md).
"""

import os
import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node

from piezo_ros.discovery import LONGEST_STANDSTILL_S, LOOPBACK, PROFILES

PERIOD_S = 0.5
# Others may only give up a process that itself notices for how long it stood still, and one that
# ended only after its last messages: a later one may list it again on a machine under heavy load.
MISSED_LOOKS = 2 + int(LONGEST_STANDSTILL_S / PERIOD_S)
PROCESSES = Path("/proc")
# Topic on which every participant of ROS 2 publishes.
PARTICIPANTS_TOPIC = "ros_discovery_info"
PREFIX_BYTES = 12
# Ports of discovery (DDSI-RTPS 2.5, 9.6.1.1), for as many processes as the profile addresses.
FIRST_PORT, PORTS_OF_DOMAIN, PORTS_OF_PROCESS, MOST_PROCESSES = 7410, 250, 2, 64
# Participants of which the processes are known.
MOST_KNOWN = 1000
# The last message of a participant: none of its own has a larger number.
LAST_MESSAGE = 2**31


class ProcessWatch:
    """A thread that announces participants of this machine whose process died or was suspended.

    It needs the transport of `prepare_discovery` that stays on this machine, and `/proc`; without
    them it does nothing. End it before its node, by which the participants are found, is destroyed.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._processes: dict[bytes, list[_Process]] = {}
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="process watch", daemon=True)
        if os.environ.get(PROFILES) == str(LOOPBACK) and PROCESSES.is_dir():
            self._thread.start()

    def end(self) -> None:
        """End the thread."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join()

    def _watch(self) -> None:
        while not self._ended.wait(PERIOD_S):
            try:
                participants = _participants(self._node)
            except (rclpy_implementation.InvalidHandle, rclpy_implementation.RCLError):
                return
            for participant in participants:
                processes = self._known_processes(participant)
                # A list, so that each process is looked at.
                if processes and all([process.is_lost() for process in processes]):
                    self._announce(participant)

    def _known_processes(self, participant: bytes) -> list["_Process"]:
        """Return the processes that a participant may have; also of one that left and came back.

        A process that was suspended announces itself again when it continues, and then ends.
        """
        known = self._processes.pop(participant, [])
        self._processes[participant] = known or list(_processes_of(participant))
        if len(self._processes) > MOST_KNOWN:
            self._processes.pop(next(iter(self._processes)))
        return self._processes[participant]

    def _announce(self, participant: bytes) -> None:
        message = end_of_participant(participant)
        first = FIRST_PORT + PORTS_OF_DOMAIN * self._node.context.get_domain_id()
        # What is not sent now is announced again by the next look.
        with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for number in range(MOST_PROCESSES):
                sender.sendto(message, ("127.0.0.1", first + PORTS_OF_PROCESS * number))


@dataclass
class _Process:
    """A process of this machine; it is lost once it was found ended or suspended often enough."""

    number: int
    started: str
    missed_looks: int = 0

    def is_lost(self) -> bool:
        state, started = _state_of(self.number)
        is_missed = state in "ZXTt" or started != self.started
        self.missed_looks = self.missed_looks + 1 if is_missed else 0
        return self.missed_looks > MISSED_LOOKS


def end_of_participant(prefix: bytes) -> bytes:
    """Return the message by which a participant would leave: the last one of its announcements.

    The prefix is the 12 bytes which begin every identifier (GUID) of the participant; see DDSI-RTPS
    2.5, 8.3.8.2 (Data), 8.5.3 (participant discovery) and 9.6.4.9 (status).
    """
    participant, reader, writer = b"\0\0\1\xc1", b"\0\1\0\xc7", b"\0\1\0\xc2"
    key = struct.pack("<HH", 0x70, 16) + prefix + participant
    disposed_and_unregistered = struct.pack("<HHI", 0x71, 4, 3 << 24)
    end_of_list = struct.pack("<HH", 1, 0)
    data = (struct.pack("<HH", 0, 16) + reader + writer + struct.pack("<iI", 0, LAST_MESSAGE)
            + key + disposed_and_unregistered + end_of_list)
    little_endian_with_parameters = 3
    header = b"RTPS" + bytes([2, 3]) + prefix[:2] + prefix
    return header + struct.pack("<BBH", 0x15, little_endian_with_parameters, len(data)) + data


def _participants(node: Node) -> set[bytes]:
    """Return the prefixes of the participants of this machine, without those of containers."""
    everywhere = {bytes(publisher.endpoint_gid[:PREFIX_BYTES]) for publisher
                  in node.get_publishers_info_by_topic(PARTICIPANTS_TOPIC, no_mangle=True)}
    here = {prefix[:4] for prefix in everywhere
            if int.from_bytes(prefix[4:6], "little") == os.getpid() % (1 << 16)}
    return {prefix for prefix in everywhere if prefix[:4] in here}


def _processes_of(prefix: bytes) -> Iterator[_Process]:
    """Yield the processes whose number ends with the 16 bits that stand in a prefix of Fast DDS."""
    lowest = int.from_bytes(prefix[4:6], "little")
    highest = int((PROCESSES / "sys/kernel/pid_max").read_text())
    for number in range(lowest, highest, 1 << 16):
        state, started = _state_of(number)
        if state not in "ZX":
            yield _Process(number, started)


def _state_of(number: int) -> tuple[str, str]:
    """Return the state of a process, `X` if there is none, and when it started."""
    try:
        fields = (PROCESSES / str(number) / "stat").read_text().rpartition(")")[2].split()
    except OSError:
        return "X", ""
    return fields[0], fields[19]
