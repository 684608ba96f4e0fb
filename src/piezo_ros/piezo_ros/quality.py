# SPDX-License-Identifier: BSD-3-Clause
"""Quality of service of the suite's topics, equal for both ends."""

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

# No sample may be lost: in lockstep a slow subscriber delays the publisher instead.
SAMPLES = QoSProfile(
    history=HistoryPolicy.KEEP_ALL,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE)

# For a stage in real time: a subscriber that hangs loses samples, without effect on others.
PACED_SAMPLES = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=2000,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE)

# The stage uses only the newest response; the depth is for a recorder that lags behind.
FEEDBACK = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=2000,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE)

# Feedback of an action: a client that lags behind must not lose any.
PROGRESS = QoSProfile(depth=1000)

# Readers of /diagnostics: every node publishes there, and a stop only once.
DIAGNOSTICS_DEPTH = 1000

# Published once, and kept for later subscribers; only the newest message counts.
DESCRIPTION = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL)
