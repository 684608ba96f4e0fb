# SPDX-License-Identifier: BSD-3-Clause
"""What the middleware does for this process: who finds it, and who waits for what it sends."""

import os
from pathlib import Path

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"
PUBLICATION_MODE = "RMW_FASTRTPS_PUBLICATION_MODE"
# As participant.xml says: how long others wait for a sign of life, and how often one is given.
LEASE_S = 3.0
ANNOUNCEMENT_S = 0.5
# How soon a reliable writer asks its readers what they lost.
RESENT_AFTER_S = 0.1
# The last sign of life may be old already, and the next come late.
LONGEST_STANDSTILL_S = LEASE_S - 2.0 * ANNOUNCEMENT_S


def prepare_discovery() -> None:
    """Stay on this machine, and announce this process often; call it before ROS is initialised.

    Others then miss a process that was killed within 3 s; by default they do after 20 s only. What
    a busy reader lost of a reliable topic comes again within 0.1 s; by default within 3 s.
    What the environment says already is left as it is.
    """
    os.environ.setdefault(RANGE, "LOCALHOST")
    os.environ.setdefault(PROFILES, str(Path(__file__).with_name("participant.xml")))


def deliver_in_background() -> None:
    """Let a thread of the middleware send what this process publishes; call it before ROS starts.

    To hand a message over takes a lock that the reader's process holds as well. Where that process
    gets no core, a writer that hands over by itself waits for it, for milliseconds, and keeps
    Python's interpreter meanwhile. What the environment says already is left as it is.
    """
    os.environ.setdefault(PUBLICATION_MODE, "ASYNCHRONOUS")
