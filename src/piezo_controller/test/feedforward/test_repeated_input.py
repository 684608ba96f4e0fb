# SPDX-License-Identifier: BSD-3-Clause
"""The mean over many periods, against playing them all."""

import tracemalloc

import numpy as np
import pytest

from piezo_controller.feedforward.periodic import FeedforwardPlanner, mean_over_repeats
from piezo_models.linear.dynamics import simulate_linear, zoh


@pytest.mark.parametrize(("once", "period", "repeats"), [(1, 1, 7), (300, 40, 1), (500, 77, 400)])
def test_mean_is_that_of_the_whole_output(stage_model, once, period, repeats):
    system = zoh(stage_model.linear(), 25e-6)
    generator = np.random.default_rng(period)
    once_v, period_v = generator.normal(size=once), generator.normal(size=period) + 1.0
    whole = simulate_linear(system, np.r_[once_v, np.tile(period_v, repeats)])
    assert mean_over_repeats(system, once_v, period_v, repeats) == pytest.approx(
        whole[once:].mean(), rel=1e-9)


def test_planning_an_hour_takes_no_more_memory_than_a_second(stage_model):
    period_um = 50.0 + 20.0 * np.sin(2 * np.pi * np.arange(400) / 400)
    peaks = []
    for duration_s in (1.0, 1.0, 3600.0):  # what is made once is made in the first
        tracemalloc.start()
        FeedforwardPlanner(400, stage_model, duration_s=duration_s).plan(period_um)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[2] < 1.1 * peaks[1]
