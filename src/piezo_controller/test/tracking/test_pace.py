# SPDX-License-Identifier: BSD-3-Clause
"""A computer that is too busy for the answers is told before a run, with how late it was."""

import pytest

from piezo_controller.tracking.pace import PROBED_TICKS, TooSlow, check_pace


def test_computer_that_cannot_keep_the_pace_is_refused():
    with pytest.raises(TooSlow, match=r"too busy to answer every 1e-06 ms: it was just .* late"):
        check_pace(1e-9, 5)


def test_pace_that_leaves_time_enough_is_kept_and_can_be_given_up():
    asked = []
    check_pace(1e-6, 10**9, lambda: asked.append(1))
    assert len(asked) == PROBED_TICKS
    with pytest.raises(ZeroDivisionError):
        check_pace(1e-6, 10**9, lambda: 1 / 0)
