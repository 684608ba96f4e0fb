# SPDX-License-Identifier: BSD-3-Clause
"""Check that the stage played a run of the loop as requested."""

from piezo_interfaces.msg import SampleBlock
from rclpy.node import Node

from piezo_ros.parameters import declare

# A computer without a real-time kernel, otherwise idle, is late with 0.2 % of the responses.
MAX_LATE_PERCENT = 1.0
# Few clipped samples at the beginning of a feedback do not matter; more change the measurement.
MAX_LIMITED_PERCENT = 1.0


class RunAccount:
    """Count the ticks of one run in which the stage deviated from what was requested.

    The run fails if more than some percent of the blocks are late, or limited. Where responses do
    not act, none are late. A streamed feedforward must never let the stage hold its last voltage.
    """

    def __init__(self, max_late_percent: float = MAX_LATE_PERCENT,
                 max_limited_percent: float = MAX_LIMITED_PERCENT, answered: bool = True,
                 streamed: bool = False) -> None:
        self._max_late_percent = max_late_percent
        self._max_limited_percent = max_limited_percent
        self._answered, self._streamed = answered, streamed
        self.blocks = self.late = self.limited = self.starved = 0

    def take(self, flags: int, ticks: int = 1) -> None:
        """Count the ticks of one block by its flags, which apply to all of them."""
        self.blocks += ticks
        if self._answered and flags & SampleBlock.FLAG_FEEDBACK_HELD:
            self.late += ticks
        if flags & (SampleBlock.FLAG_RANGE_LIMITED | SampleBlock.FLAG_SLEW_LIMITED):
            self.limited += ticks
        if self._streamed and flags & SampleBlock.FLAG_FEEDFORWARD_HELD:
            self.starved += ticks

    @property
    def failure(self) -> str:
        """Return why the run failed; empty if it did not."""
        failures = []
        if self._exceeds(self.late, self._max_late_percent):
            failures.append(f"{self._late}, more than max_late_percent, "
                            f"{self._max_late_percent:g}: relieve the computer")
        if self._exceeds(self.limited, self._max_limited_percent):
            failures.append(f"{self._limited}, more than max_limited_percent, "
                            f"{self._max_limited_percent:g}: ask for less travel or speed")
        if self.starved:
            failures.append(f"the feedforward arrived too late for {self.starved} of {self.blocks} "
                            "ticks: relieve the computer")
        return "; ".join(failures)

    @property
    def note(self) -> str:
        """Return a remark on a run that did not fail; may be empty."""
        counted = ((self.late, self._late), (self.limited, self._limited))
        return "; ".join(text for count, text in counted if count)

    @property
    def _late(self) -> str:
        return f"{self.late} of {self.blocks} answers were late"

    @property
    def _limited(self) -> str:
        return f"the stage limited the voltage in {self.limited} of {self.blocks} ticks"

    def _exceeds(self, count: int, percent: float) -> bool:
        return 100.0 * count > percent * self.blocks


def declare_run_limits(node: Node) -> dict[str, float]:
    """Declare ``max_late_percent`` and ``max_limited_percent``, arguments of `RunAccount`."""
    return {
        "max_late_percent": declare(
            node, "max_late_percent", MAX_LATE_PERCENT,
            "A run in which more of the answers come late fails (percent).", 0.0, 100.0),
        "max_limited_percent": declare(
            node, "max_limited_percent", MAX_LIMITED_PERCENT,
            "A run in which the stage limits the voltage in more of the ticks fails (percent).",
            0.0, 100.0)}
