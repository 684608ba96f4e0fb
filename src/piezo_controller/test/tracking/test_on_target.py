# SPDX-License-Identifier: BSD-3-Clause
"""Since when an error is within its tolerance, beside a look at every window written out."""

import numpy as np
import pytest

from piezo_controller.tracking.on_target import STEP_SAMPLES, WINDOW_SAMPLES, OnTarget


def looked_at(error_um, tolerance_um):
    """Go through the windows one by one."""
    since = None
    for begin in range(0, len(error_um) - WINDOW_SAMPLES + 1, STEP_SAMPLES):
        rms_um = np.sqrt(np.mean(error_um[begin:begin + WINDOW_SAMPLES] ** 2))
        if not rms_um <= tolerance_um:
            since = None
        elif since is None:
            since = begin
    return since


def errors_um(seed):
    """Noise that is too large at times, until somewhere in the last second or for ever."""
    draws = np.random.default_rng(seed)
    error_um = 0.02 * draws.normal(size=20_000)
    for _ in range(4):
        begin = draws.integers(0, 20_000)
        error_um[begin:begin + draws.integers(1, 900)] += 0.2
    return error_um


@pytest.mark.parametrize("block", [
    pytest.param(1, marks=pytest.mark.long), 40, 130, 2000, 20_000])
def test_moment_does_not_depend_on_the_blocks(block):
    told = []
    for seed in range(8):
        error_um = errors_um(seed)
        target = OnTarget(0.05)
        for begin in range(0, len(error_um), block):
            target.add(error_um[begin:begin + block])
            if begin and begin % 8000 == 0:
                assert target.since_sample == looked_at(error_um[:begin + block], 0.05)
        assert target.since_sample == looked_at(error_um, 0.05)
        told.append(target.since_sample)
    assert len(set(told)) > 4 and any(told)


def test_error_that_is_no_number_is_not_on_target():
    target = OnTarget(0.05)
    target.add(np.zeros(800))
    assert target.since_sample == 0
    target.add(np.full(40, np.nan))
    assert target.since_sample is None
    target.add(np.zeros(400))
    assert target.since_sample == 840
