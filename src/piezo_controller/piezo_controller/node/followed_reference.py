# SPDX-License-Identifier: BSD-3-Clause
"""The topic ``controller/reference``: the reference that a run follows, to be recorded."""

import array

import numpy as np
from builtin_interfaces.msg import Time
from piezo_interfaces.msg import SampleBlock, TrackedReference
from rclpy.node import Node

from piezo_common.arrays import FloatArray
from piezo_ros.quality import FEEDBACK

SAMPLES_PER_MESSAGE = 4000
"""One message per tick would take the loop as long as an answer does."""


class FollowedReference:
    """Publish the expected displacements of the samples that a stage has measured."""

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
