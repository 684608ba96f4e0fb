# SPDX-License-Identifier: BSD-3-Clause
"""Ticks are late by the clock of the backend, whatever the computer's clock makes of it."""

import numpy as np
import pytest

from piezo_stage_driver.engine.tick_times import TickTimes

TICK_S = 1e-3


class Hardware:
    """Measures 40 samples a millisecond of a time that passes only here and in `work`."""

    sample_rate_hz = 40_000.0
    name = "made of time"

    def __init__(self, lead_samples=0, slower=0.0, anew_after_s=np.inf):
        self._anew_after_s = anew_after_s
        self.lead_samples, self._period_s = lead_samples, TICK_S * (1.0 + slower)
        self.now_s = self._measured_s = 7.0

    def open(self):
        self._measured_s = self.now_s

    def exchange(self, voltage_v):
        self._measured_s += self._period_s
        if self.now_s > self._measured_s + self._anew_after_s:
            self._measured_s = self.now_s
        self.now_s = max(self.now_s, self._measured_s)
        return np.zeros(len(voltage_v))

    def work(self, time_s):
        self.now_s += time_s


def play(hardware, works_s):
    """Return the counts of a loop that works for so long between its exchanges."""
    times = TickTimes(hardware, lambda: hardware.now_s)
    times.open()
    times.exchange(np.zeros(40))
    for work_s in works_s:
        hardware.work(work_s)
        times.exchange(np.zeros(40))
    return times


@pytest.mark.parametrize("slower", [-2e-4, 0.0, 4e-4])
def test_no_tick_of_a_loop_in_time_is_late_though_the_clocks_differ(slower):
    times = play(Hardware(slower=slower), [0.1 * TICK_S] * 20_000)
    assert (times.ticks, times.missed) == (20_000, 0)
    assert times.lateness.counts[0] == 20_000
    assert times.described()["ticks_within_0.2_ms"] == 20_000


def test_a_pause_is_missed_by_every_tick_until_the_loop_has_caught_up():
    times = play(Hardware(), [1e-4] * 500 + [5.5 * TICK_S] + [0.0] * 500)
    # 5.5 ms late, then 4.5, 3.5, 2.5 and 1.5: each by more than a tick.
    assert times.missed == 5
    assert times.lateness.longest_ms == pytest.approx(5.5, rel=0.01)
    assert times.described()["missed_deadlines"] == 5


def test_a_pause_after_which_the_clock_is_set_anew_is_missed_once():
    """No tick behind it is late: otherwise one pause would spoil the count of minutes."""
    works_s = [1e-4] * 500 + [115e-3] + [1e-4] * 5000
    times = play(Hardware(anew_after_s=0.1), works_s)
    assert times.missed == 1
    assert times.lateness.longest_ms == pytest.approx(115.0 - 1.0, abs=1.1)
    # A pause that the clock waits for is caught up with.
    assert play(Hardware(anew_after_s=0.1), [1e-4] * 500 + [80e-3] + [0.0] * 500).missed > 70


def test_what_is_written_ahead_may_be_late_by_as_much():
    assert play(Hardware(lead_samples=400), [9.5 * TICK_S, 0.0]).missed == 0
    assert play(Hardware(lead_samples=400), [10.5 * TICK_S, 0.0]).missed == 1


def test_counts_begin_anew_with_each_opening_and_the_backend_shows_through():
    times = play(Hardware(), [3.0 * TICK_S])
    assert times.name == "made of time"
    times.open()
    assert (times.ticks, times.missed, times.lateness.longest_ms) == (0, 0, 0.0)
