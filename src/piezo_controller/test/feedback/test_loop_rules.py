# SPDX-License-Identifier: BSD-3-Clause
"""Rules for bandwidth and rate, with the thesis' own figures."""

import numpy as np
import pytest

from piezo_controller.feedback.stage_design import choose_rates
from piezo_controller.feedback.synthesis.weights import Weight, load_weights

CLOCK_HZ = 40000.0


def test_thesis_figures_give_the_thesis_choice():
    rules = choose_rates(500.0, CLOCK_HZ, 50e-6, 40)
    assert rules.samples_per_tick == 40
    assert (rules.lowest_rate_hz, rules.highest_rate_hz) == (1000.0, 20000.0)
    assert (rules.lowest_bandwidth_hz, rules.highest_bandwidth_hz) == (40.0, 500.0)
    assert (rules.performance_hz, rules.robustness_hz) == (40.0, 500.0)


def test_faster_stage_gets_the_slowest_rate_within_the_bounds():
    rules = choose_rates(900.0, CLOCK_HZ, 50e-6, 40)
    rate_hz = CLOCK_HZ / rules.samples_per_tick
    assert 1800.0 <= rate_hz < 1800.0 * (1 + 1 / rules.samples_per_tick)


def test_usual_rate_that_cannot_be_computed_is_not_chosen():
    assert choose_rates(500.0, CLOCK_HZ, 50e-6, 1).samples_per_tick == 40


@pytest.mark.parametrize("arguments, message", [
    (dict(ultimate_hz=500.0, computing_s=2e-3), "lower the controller's order"),
    (dict(ultimate_hz=30.0, computing_s=5e-5), "need a bandwidth of 40 Hz, but 30 Hz is the most"),
])
def test_bounds_that_leave_nothing_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        choose_rates(clock_hz=CLOCK_HZ, usual_samples_per_tick=40, **arguments)


@pytest.mark.parametrize("weight", [
    Weight(gain=0.1, zeros=[-1.0], poles=[0.9995]),
    Weight(gain=1.25, zeros=[0.2283, 0.2283], poles=[-0.7254, -0.7254]),
    Weight(gain=2.0, zeros=[], poles=[]), Weight(gain=0.3, zeros=[], poles=[0.5])])
@pytest.mark.parametrize("factor", [0.5, 1.7])
def test_stretched_weight_has_its_values_at_frequencies_as_much_higher(weight, factor):
    before = np.array([0.01, 0.1, 0.4, 1.0])
    after = 2 * np.arctan(factor * np.tan(before / 2))
    stretched = weight.stretched(factor).state_space(1.0)
    assert np.abs(stretched(np.exp(1j * after), squeeze=True)) * np.ones(4) == pytest.approx(
        np.abs(weight.state_space(1.0)(np.exp(1j * before), squeeze=True)) * np.ones(4), rel=1e-9)


def test_weights_at_another_tick_ask_the_same_at_low_frequencies():
    weights = load_weights("thesis")
    faster = weights.at_tick(0.5e-3)
    assert faster.sample_period_s == 0.5e-3
    for name in ("performance", "disturbance", "noise", "control"):
        values = [abs(getattr(w, name).state_space(w.sample_period_s)(
            np.exp(2j * np.pi * 20.0 * w.sample_period_s))) for w in (weights, faster)]
        assert values[0] == pytest.approx(values[1], rel=0.01)


def test_wider_disturbances_move_what_is_asked_for_them_alone():
    weights = load_weights("thesis")
    moved = weights.for_disturbances(40.0)
    assert moved.disturbance.poles[0] == pytest.approx(
        (1 - np.tan(np.pi * 0.04)) / (1 + np.tan(np.pi * 0.04)), rel=0.01)
    assert moved.model_copy(update={"performance": weights.performance,
                                    "disturbance": weights.disturbance}) == weights
