# SPDX-License-Identifier: BSD-3-Clause
"""Tell whether the stage played what it was asked to in a run of the loop."""

from piezo_interfaces.msg import SampleBlock
from rclpy.node import Node

from piezo_ros.parameters import declare

# A computer without real-time kernel that does nothing else is late with 0.2 % of the answers.
MAX_LATE_PERCENT = 1.0
# A clipped sample or two where a feedback begins do not matter; more change what is measured.
MAX_LIMITED_PERCENT = 1.0


class RunAccount:
    """Count the ticks of one run in which the stage did something else than it was asked to.

    Parameters
    ----------
    max_late_percent, max_limited_percent : float
        Share of the blocks from which on the run does not count as done.
    answered : bool
        Whether answers act.
    streamed : bool
        Whether the feedforward is streamed: the stage then never is to hold its last voltage.
    """

    def __init__(self, max_late_percent: float = MAX_LATE_PERCENT,
                 max_limited_percent: float = MAX_LIMITED_PERCENT, answered: bool = True,
                 streamed: bool = False) -> None:
        self._max_late_percent = max_late_percent
        self._max_limited_percent = max_limited_percent
        self._answered, self._streamed = answered, streamed
        self.blocks = self.late = self.limited = self.starved = 0

    def take(self, flags: int, ticks: int = 1) -> None:
        """Count one block by its flags, which are those of all its ticks."""
        self.blocks += ticks
        if self._answered and flags & SampleBlock.FLAG_FEEDBACK_HELD:
            self.late += ticks
        if flags & (SampleBlock.FLAG_RANGE_LIMITED | SampleBlock.FLAG_SLEW_LIMITED):
            self.limited += ticks
        if self._streamed and flags & SampleBlock.FLAG_FEEDFORWARD_HELD:
            self.starved += ticks

    @property
    def failure(self) -> str:
        """Tell why the run does not count as done; empty if it does."""
        failures = []
        if self._exceeds(self.late, self._max_late_percent):
            failures.append(f"{self._late}, more than max_late_percent, "
                            f"{self._max_late_percent:g}: relieve the computer")
        if self._exceeds(self.limited, self._max_limited_percent):
            failures.append(f"{self._limited}, more than max_limited_percent, "
                            f"{self._max_limited_percent:g}: ask for less travel or speed")
        if self.starved:
            failures.append(f"the feedforward came too late for {self.starved} of {self.blocks} "
                            "ticks: relieve the computer")
        return "; ".join(failures)

    @property
    def note(self) -> str:
        """Return what to tell of a run that counts as done; may be empty."""
        counted = ((self.late, self._late), (self.limited, self._limited))
        return "; ".join(text for count, text in counted if count)

    @property
    def _late(self) -> str:
        return f"{self.late} of {self.blocks} answers came late"

    @property
    def _limited(self) -> str:
        return f"the stage limited the voltage in {self.limited} of {self.blocks} ticks"

    def _exceeds(self, count: int, percent: float) -> bool:
        return 100.0 * count > percent * self.blocks


def declare_run_limits(node: Node) -> dict[str, float]:
    """Declare the parameters ``max_late_percent`` and ``max_limited_percent``.

    Returns
    -------
    dict
        Arguments of `RunAccount`.
    """
    return {
        "max_late_percent": declare(
            node, "max_late_percent", MAX_LATE_PERCENT,
            "A run in which more of the answers come late fails (percent).", 0.0, 100.0),
        "max_limited_percent": declare(
            node, "max_limited_percent", MAX_LIMITED_PERCENT,
            "A run in which the stage limits the voltage in more of the ticks fails (percent).",
            0.0, 100.0)}
