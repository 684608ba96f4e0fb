# SPDX-License-Identifier: BSD-3-Clause
"""The topic ``reference``, on which other nodes publish what the stage shall follow."""

import time
from collections.abc import Callable

from piezo_interfaces.msg import ReferenceSamples
from rclpy.node import Node

from piezo_controller.references.kind import InvalidReference
from piezo_controller.references.live_reference import LiveReference
from piezo_ros.quality import FEEDBACK

APPEARANCE_S = 10.0
POLL_S = 0.02
LOCKSTEP_PATIENCE_S = 5.0
"""How long a stage in lockstep waits for the publisher (s); a paced one cannot wait."""

WARNING_PERIOD_S = 1.0


class ReferenceTopic:
    """Pass on published values while a run follows them; `wake` is called when new ones come."""

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
