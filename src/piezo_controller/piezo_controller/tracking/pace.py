# SPDX-License-Identifier: BSD-3-Clause
"""Check whether this computer, at its present load, is fast enough to answer a stage."""

import os
import time
from collections.abc import Callable

from piezo_common.side_by_side import cores

PROBED_TICKS = 500


class TooSlow(ValueError):
    """The computer would miss too many answers in a row; the message gives the largest delay."""


def check_pace(tick_s: float, max_missed: int, check: Callable[[], None] = lambda: None) -> None:
    """Wake up at every tick for a while, as the answering thread does; raise `TooSlow` if late.

    The stage stops after more than `max_missed` consecutive missed answers. The function `check` is
    called from time to time, and may raise to end the check.
    """
    begin_s, latest_s = time.monotonic(), 0.0
    for tick in range(1, PROBED_TICKS + 1):
        due_s = begin_s + tick * tick_s
        time.sleep(max(due_s - time.monotonic(), 0.0))
        latest_s = max(latest_s, time.monotonic() - due_s)
        check()
        if latest_s > max_missed * tick_s:
            raise TooSlow(
                f"this computer is too busy to answer every {1e3 * tick_s:g} ms: it was just "
                f"{1e3 * latest_s:.1f} ms late, and the stage stops where more than {max_missed} "
                f"answers are missed in a row (load {os.getloadavg()[0]:.1f} on {cores()} "
                "processors): end other programs, or track a periodic reference with the feedback "
                "onboard")
