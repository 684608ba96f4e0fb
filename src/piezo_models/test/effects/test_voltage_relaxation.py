# SPDX-License-Identifier: BSD-3-Clause
"""A share of the voltage that comes late, beside SciPy's simulation of the same."""

import numpy as np
import pytest
from scipy.signal import lsim

from piezo_models.effects.amplifier_lag import AmplifierLag
from piezo_models.effects.voltage_relaxation import VoltageRelaxation

PERIOD_S, TIME_S, SHARE = 1e-3, 5e-3, 0.25
VOLTAGE_V = np.convolve(np.random.default_rng(4).normal(size=400), np.hanning(20), mode="same")


def test_a_share_comes_late_and_the_rest_at_once():
    time_s = PERIOD_S * np.arange(VOLTAGE_V.size)
    moved_v = VOLTAGE_V - VOLTAGE_V[0]
    _, late_v, _ = lsim(([1.0], [TIME_S, 1.0]), moved_v, time_s)
    found_v = VoltageRelaxation(TIME_S, SHARE).apply(VOLTAGE_V, PERIOD_S)
    assert found_v - VOLTAGE_V[0] == pytest.approx((1.0 - SHARE) * moved_v + SHARE * late_v)


def test_no_share_changes_nothing():
    assert VoltageRelaxation(TIME_S, 0.0).apply(VOLTAGE_V, PERIOD_S) == pytest.approx(VOLTAGE_V)


def test_it_lies_between_the_voltage_and_one_of_which_all_comes_late():
    late_v = AmplifierLag(TIME_S).apply(VOLTAGE_V, PERIOD_S)
    found_v = VoltageRelaxation(TIME_S, SHARE).apply(VOLTAGE_V, PERIOD_S)
    assert found_v == pytest.approx(VOLTAGE_V + SHARE * (late_v - VOLTAGE_V))


def test_slow_voltages_come_late_by_its_share_of_the_time_constant():
    effect, ramp_v = VoltageRelaxation(TIME_S, SHARE), np.linspace(0.0, 10.0, 2_000)
    late_v = ramp_v - effect.apply(ramp_v, PERIOD_S)
    assert late_v[-1] / (ramp_v[1] / PERIOD_S) == pytest.approx(effect.slow_delay_s)


def test_a_feedback_loop_meets_its_response():
    s = 2j * np.pi * 50.0
    wanted = 1.0 - SHARE + SHARE / (1.0 + TIME_S * s)
    assert VoltageRelaxation(TIME_S, SHARE).lag()(s) == pytest.approx(wanted)
