# SPDX-License-Identifier: BSD-3-Clause
"""Quality of service of the suite's topics, chosen once for both ends."""

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

# No sample may be lost: in lockstep a slow subscriber holds the publisher back instead.
SAMPLES = QoSProfile(
    history=HistoryPolicy.KEEP_ALL,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE)

# Of a stage whose time goes on: a subscriber that hangs loses samples, and nobody else does.
PACED_SAMPLES = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=2000,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE)

# The stage takes the newest answer only; the depth is for a recorder that lags behind.
FEEDBACK = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=2000,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE)

# How an action gets on: a client that lags behind is to miss nothing.
PROGRESS = QoSProfile(depth=1000)

# Readers of /diagnostics: every node tells something there, and a stop is told once only.
DIAGNOSTICS_DEPTH = 1000

# Told once, and still there for who comes later; only the newest counts.
DESCRIPTION = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL)
