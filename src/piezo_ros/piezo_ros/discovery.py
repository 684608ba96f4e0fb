# SPDX-License-Identifier: BSD-3-Clause
"""What the middleware does for this process: who finds it, and who waits for what it sends."""

import os
from pathlib import Path

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
LOCALHOST_ONLY = "ROS_LOCALHOST_ONLY"
MIDDLEWARE, FAST_DDS = "RMW_IMPLEMENTATION", "rmw_fastrtps"
PEERS = "ROS_STATIC_PEERS"
PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"
PUBLICATION_MODE = "RMW_FASTRTPS_PUBLICATION_MODE"
# UDP on this machine alone, and UDP with whoever is there.
LOOPBACK, NETWORK = (Path(__file__).with_name(f"{name}.xml")
                     for name in ("participant", "network"))
# As both say: how long others wait for a sign of life, and how often one is given.
LEASE_S = 3.0
ANNOUNCEMENT_S = 0.5
# How soon a reliable writer asks its readers what they lost.
RESENT_AFTER_S = 0.1
# The last sign of life may be old already, and the next come late.
LONGEST_STANDSTILL_S = LEASE_S - 2.0 * ANNOUNCEMENT_S


def prepare_discovery() -> None:
    """Stay on this machine, and announce this process often; call it before ROS is initialised.

    Others then miss a process that was killed within 3 s; by default they do after 20 s only. What
    a busy reader lost of a reliable topic comes again within 0.1 s; by default within 3 s. Messages
    go by UDP: in the shared memory of the middleware a killed reader keeps its room for ever.

    A profile of the user's own is left as it is, and so is another middleware; they get the range
    LOCALHOST where none is set. A range or peers that let other machines in stay as well.
    """
    profile = Path(os.environ.get(PROFILES, "")).name
    fast_dds = os.environ.get(MIDDLEWARE, FAST_DDS).startswith(FAST_DDS)
    if not fast_dds or profile not in ("", LOOPBACK.name, NETWORK.name):
        os.environ.setdefault(RANGE, "LOCALHOST")
    elif _stays_here(profile):
        # Under LOCALHOST the middleware adds shared memory that no profile turns off.
        os.environ[RANGE] = "SYSTEM_DEFAULT"
        os.environ.pop(LOCALHOST_ONLY, None)
        os.environ[PROFILES] = str(LOOPBACK)
    else:
        os.environ[PROFILES] = str(NETWORK)


def _stays_here(profile: str) -> bool:
    """Tell whether the environment keeps this process on its machine, by itself or as set here."""
    if os.environ.get(LOCALHOST_ONLY) == "1":
        return True
    if os.environ.get(PEERS):
        return False
    chosen = os.environ.get(RANGE, "LOCALHOST").upper()
    return chosen == "LOCALHOST" or (chosen == "SYSTEM_DEFAULT" and profile == LOOPBACK.name)


def deliver_in_background() -> None:
    """Let a thread of the middleware send what this process publishes; call it before ROS starts.

    To hand a message over takes the kernel's time, and a lock of the middleware. A writer that
    hands over by itself keeps Python's interpreter meanwhile. What the environment says already is
    left as it is.
    """
    os.environ.setdefault(PUBLICATION_MODE, "ASYNCHRONOUS")
