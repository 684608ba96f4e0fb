# SPDX-License-Identifier: BSD-3-Clause
"""An amplifier of second order in front of the hysteresis."""

import numpy as np
import pytest
from scipy.signal import lsim

from piezo_models.effects.amplifier_lag import AmplifierLag
from piezo_models.effects.second_order_amplifier import SecondOrderAmplifier

PERIOD_S, TIME_S, QUALITY = 1e-5, 3e-5, 0.8


def test_the_hysteresis_gets_the_means_of_the_voltage_behind_a_held_one():
    random = np.random.default_rng(2)
    held_v, fine = random.uniform(0.0, 100.0, 60), 400
    time_s = PERIOD_S / fine * np.arange(held_v.size * fine + 1)
    system = ([1.0], [(QUALITY * TIME_S) ** 2, TIME_S, 1.0])
    _, behind_v, _ = lsim(system, np.append(np.repeat(held_v - held_v[0], fine), 0.0), time_s,
                          interp=False)
    means_v = behind_v[:-1].reshape(-1, fine).mean(axis=1) + held_v[0]
    found_v = SecondOrderAmplifier(TIME_S, QUALITY).apply(held_v, PERIOD_S)
    # The first mean of the finer simulation is that of the points at which its steps begin.
    assert found_v == pytest.approx(means_v, abs=0.2)
    assert np.std(found_v - means_v) < 0.1


def test_a_small_quality_factor_is_a_single_lag():
    voltage_v = np.repeat([0.0, 50.0, 20.0], 40)
    single_v = AmplifierLag(TIME_S).apply(voltage_v, PERIOD_S)
    errors_v = [np.abs(SecondOrderAmplifier(TIME_S, quality).apply(voltage_v, PERIOD_S)
                       - single_v).max() for quality in (0.2, 0.1, 0.05)]
    assert errors_v[0] > 2.0 * errors_v[1] > 4.0 * errors_v[2]
    assert errors_v[2] < 0.2


def test_slow_voltages_come_late_by_the_time_constant_whatever_the_quality_is():
    ramp_v = np.linspace(0.0, 10.0, 2_000)
    for quality in (0.3, 0.5, 2.0):
        late_v = ramp_v - SecondOrderAmplifier(TIME_S, quality).apply(ramp_v, PERIOD_S)
        assert late_v[-1] / (ramp_v[1] * 100.0) == pytest.approx(
            TIME_S / (100.0 * PERIOD_S), rel=1e-6)


def test_a_feedback_loop_meets_its_response():
    s = 2j * np.pi * 5e3
    wanted = 1.0 / (1.0 + TIME_S * s + (QUALITY * TIME_S * s) ** 2)
    assert SecondOrderAmplifier(TIME_S, QUALITY).lag()(s) == pytest.approx(wanted)
