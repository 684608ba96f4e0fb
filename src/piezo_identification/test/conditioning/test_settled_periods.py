# SPDX-License-Identifier: BSD-3-Clause
"""From which period on a square wave has settled, against periods of known decay."""

import numpy as np
import pytest

from piezo_identification.conditioning.waveforms import first_settled_step

LENGTH = 400
STEPS = np.arange(1, 41) * LENGTH // 2


def signal(ringing=0.0, periods_to_decay=1.0, noise=0.01):
    """Twenty periods whose ringing from before decays by 1/e over some periods."""
    place = np.arange(STEPS[-1] + LENGTH // 2)
    random = np.random.default_rng(1).normal(size=place.size)
    decay = np.exp(-place / (periods_to_decay * LENGTH))
    return (place // (LENGTH // 2) % 2 + ringing * decay * np.sin(0.3 * place) + noise * random
            + 0.2 * np.log1p(place / LENGTH))


def test_periods_that_settled_at_once_are_all_used():
    assert first_settled_step(signal(), STEPS, 0) == 0
    assert first_settled_step(signal(), STEPS, STEPS[2] - 5) == 2


@pytest.mark.parametrize("periods_to_decay", [0.5, 1.0])
def test_what_rings_on_is_left_out_until_noise_hides_it(periods_to_decay):
    first = first_settled_step(signal(1.0, periods_to_decay), STEPS, 0)
    square = np.exp(-2.0 * STEPS[first] / (periods_to_decay * LENGTH))
    share = 0.5 * periods_to_decay * (1.0 - np.exp(-2.0 / periods_to_decay))
    # Power of the ringing in the first period that is used, and in the one before.
    power, before = 0.5 * share * square * np.array([1.0, np.exp(2.0 / periods_to_decay)])
    assert power < 0.4 * 0.01**2 < before


def test_no_more_than_half_is_left_out_and_few_periods_are_all_used():
    assert first_settled_step(signal(1.0, 50.0, 1e-6), STEPS, 0) <= 20
    few = STEPS[:6]
    assert first_settled_step(signal(1.0, 3.0), few, 0) == 0


def test_a_wave_that_is_not_periodic_is_used_from_the_earliest_step():
    uneven = STEPS.copy()
    uneven[7] += 3
    assert first_settled_step(signal(1.0), uneven, STEPS[3]) == 3
