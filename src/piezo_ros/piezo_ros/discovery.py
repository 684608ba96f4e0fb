# SPDX-License-Identifier: BSD-3-Clause
"""Set up the middleware for this process: discovery, liveliness and asynchronous sending."""

import os
import re
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
LOCALHOST_ONLY = "ROS_LOCALHOST_ONLY"
MIDDLEWARE, FAST_DDS = "RMW_IMPLEMENTATION", "rmw_fastrtps"
PEERS = "ROS_STATIC_PEERS"
PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"
PUBLICATION_MODE = "RMW_FASTRTPS_PUBLICATION_MODE"
# UDP on this machine only, and UDP on the network.
LOOPBACK, NETWORK = (Path(__file__).with_name(f"{name}.xml")
                     for name in ("participant", "network"))
# Lease of liveliness on this machine, where `ProcessWatch` detects a process that died, and in the
# network; period of the announcements of both.
LEASE_S = {LOOPBACK: 600.0, NETWORK: 3.0}
ANNOUNCEMENT_S = 0.5
# Time after which a reliable writer repeats lost messages.
RESENT_AFTER_S = 0.1
# Messages that a reader has not acknowledged, after which a writer that holds back waits for it; a
# socket of the usual size has room for so many blocks of samples.
MOST_UNACKNOWLEDGED = 50
# The last announcement may be one period old already, and the next one late.
LONGEST_STANDSTILL_S = LEASE_S[NETWORK] - 2.0 * ANNOUNCEMENT_S


def prepare_discovery() -> None:
    """Limit discovery to this machine, and announce this process often; call it before ROS starts.

    In the network, other processes then detect within 3 s that this one was killed, by default only
    after 20 s; on this machine, `ProcessWatch` detects it.
    What a busy reader lost of a reliable topic is repeated within 0.1 s; by default within 3 s.
    Messages use UDP, as a killed reader would occupy its part of the middleware's shared memory for
    ever.

    A profile of the user and another middleware are not changed; they get the range LOCALHOST if
    none is set. A range or peers that include other machines are not changed either.
    """
    profile = Path(os.environ.get(PROFILES, "")).name
    fast_dds = os.environ.get(MIDDLEWARE, FAST_DDS).startswith(FAST_DDS)
    if not fast_dds or profile not in ("", LOOPBACK.name, NETWORK.name):
        os.environ.setdefault(RANGE, "LOCALHOST")
    elif _stays_here(profile):
        # Under LOCALHOST the middleware adds shared memory that no profile can disable.
        os.environ[RANGE] = "SYSTEM_DEFAULT"
        os.environ.pop(LOCALHOST_ONLY, None)
        os.environ[PROFILES] = str(LOOPBACK)
    else:
        os.environ[PROFILES] = str(NETWORK)


def _stays_here(profile: str) -> bool:
    """Return True if the environment limits this process to its machine, also as set here."""
    if os.environ.get(LOCALHOST_ONLY) == "1":
        return True
    if os.environ.get(PEERS):
        return False
    chosen = os.environ.get(RANGE, "LOCALHOST").upper()
    return chosen == "LOCALHOST" or (chosen == "SYSTEM_DEFAULT" and profile == LOOPBACK.name)


@contextmanager
def holding_back(topic: str, arguments: Sequence[str]) -> Iterator[None]:
    """Let the node created meanwhile hold back the messages of a topic, if any; it keeps all.

    By default a writer that keeps all its messages goes 5000 ahead of a slow reader. What does not
    fit into the socket of the reader is sent again and again, and answers to requests of the reader
    do not get through. With this, the writer waits after `MOST_UNACKNOWLEDGED` messages.

    The middleware knows such limits only by the full name of the topic, and from its profile. The
    name follows from the namespace in the arguments of the process. A profile of the user is not
    changed.
    """
    own = os.environ.get(PROFILES, "")
    if not topic or own not in map(str, (LOOPBACK, NETWORK)):
        yield
        return
    try:
        folder = tempfile.TemporaryDirectory()
    except OSError:  # Without a place for files, the writer goes as far ahead as usual.
        yield
        return
    with folder as directory:
        profile = Path(directory) / Path(own).name
        profile.write_text(_holding_back(Path(own).read_text(), topic, arguments))
        os.environ[PROFILES] = str(profile)
        try:
            yield
        finally:
            os.environ[PROFILES] = own


def _holding_back(profiles: str, topic: str, arguments: Sequence[str]) -> str:
    """Return profiles with one more, of the writer of a topic, that waits for its readers."""
    namespaces = [found[1] for each in arguments if (found := re.search(r"__ns:=(\S+)", each))]
    name = f"{namespaces[-1].rstrip('/') if namespaces else ''}/{topic}"
    nanoseconds = round(RESENT_AFTER_S * 1e9)
    writer = f"""<data_writer profile_name="{name}">
      <topic><resourceLimitsQos>
        <max_samples>{MOST_UNACKNOWLEDGED}</max_samples>
        <max_samples_per_instance>{MOST_UNACKNOWLEDGED}</max_samples_per_instance>
        <allocated_samples>{MOST_UNACKNOWLEDGED}</allocated_samples>
      </resourceLimitsQos></topic>
      <times><heartbeatPeriod><sec>0</sec><nanosec>{nanoseconds}</nanosec></heartbeatPeriod></times>
    </data_writer>
  </profiles>"""
    return profiles.replace("</profiles>", writer)


def deliver_in_background() -> None:
    """Let a thread of the middleware send what this process publishes; call it before ROS starts.

    Sending takes time in the kernel, and a lock of the middleware. A writer that sends
    synchronously holds Python's interpreter lock meanwhile. A mode set in the environment is not
    changed.
    """
    os.environ.setdefault(PUBLICATION_MODE, "ASYNCHRONOUS")
