# SPDX-License-Identifier: BSD-3-Clause
"""The topics of references: published by others to be followed, and followed by a run."""

import array
import time
from collections.abc import Callable

import numpy as np
from builtin_interfaces.msg import Time
from piezo_interfaces.msg import ReferenceSamples, SampleBlock, TrackedReference
from rclpy.node import Node

from piezo_common.arrays import FloatArray
from piezo_controller.references.kind import InvalidReference
from piezo_controller.references.live_reference import LiveReference
from piezo_ros.quality import FEEDBACK

APPEARANCE_S = 10.0
POLL_S = 0.02
LOCKSTEP_PATIENCE_S = 5.0
"""How long a stage in lockstep waits for the publisher (s); a paced one cannot wait."""

WARNING_PERIOD_S = 1.0

SAMPLES_PER_MESSAGE = 4000
"""One message per tick would take the loop as long as an answer does."""


class ReferenceTopic:
    """Pass on values of ``reference`` while a run follows them, and call `wake` for new ones."""

    def __init__(self, node: Node, wake: Callable[[], None]) -> None:
        self._node, self._wake = node, wake
        self._live: LiveReference | None = None
        self._subscription = node.create_subscription(
            ReferenceSamples, "reference", self._take, FEEDBACK)

    def begin(self, sample_period_s: float, lockstep: bool, offset_um: float,
              check: Callable[[], None]) -> LiveReference:
        """Wait for the first value; `check` is called from time to time, and may raise.

        A stage in lockstep waits for the publisher. Raises `InvalidReference` if no node, or more
        than one, publishes.
        """
        live = self._live = LiveReference(
            sample_period_s, LOCKSTEP_PATIENCE_S if lockstep else 0.0, offset_um)
        topic, deadline_s = self._subscription.topic_name, time.monotonic() + APPEARANCE_S
        while not live.begun:
            check()
            if time.monotonic() > deadline_s:
                raise InvalidReference(f"nothing was published on {topic} within "
                                       f"{APPEARANCE_S:g} s: start what publishes the reference")
            time.sleep(POLL_S)
        publishers = self._node.count_publishers(topic)
        if publishers > 1:
            raise InvalidReference(f"{publishers} nodes publish on {topic}: stop all but one")
        return live

    def end(self) -> None:
        """Ignore what is published from now on."""
        self._live = None

    def _take(self, message: ReferenceSamples) -> None:
        live = self._live
        if live is None:
            return
        try:
            live.take(message.first_sample, message.sample_period_s, message.preview_samples,
                      message.displacement_um)
        except InvalidReference as error:
            self._node.get_logger().warning(f"reference ignored: {error}",
                                            throttle_duration_sec=WARNING_PERIOD_S)
        else:
            self._wake()


class FollowedReference:
    """Publish, on ``controller/reference``, the displacements to expect of measured samples."""

    def __init__(self, node: Node) -> None:
        self._publisher = node.create_publisher(TrackedReference, "controller/reference", FEEDBACK)
        self._begin: tuple[int, float, Time] | None = None
        self._parts: list[FloatArray] = []

    def take(self, block: SampleBlock, expected_um: FloatArray) -> None:
        """Add the expected displacements of a block; fewer than its samples at the end of a run."""
        if not expected_um.size:
            return
        if self._begin is None:
            self._begin = block.first_sample, block.sample_period_s, block.header.stamp
        self._parts.append(expected_um)
        if sum(part.size for part in self._parts) >= SAMPLES_PER_MESSAGE:
            self.flush()

    def flush(self) -> None:
        """Publish what has not been published yet."""
        if self._begin is None:
            return
        first_sample, sample_period_s, stamp = self._begin
        message = TrackedReference(
            first_sample=first_sample, sample_period_s=sample_period_s,
            displacement_um=array.array("d", np.concatenate(self._parts).tobytes()))
        message.header.stamp = stamp
        self._publisher.publish(message)
        self._begin, self._parts = None, []
