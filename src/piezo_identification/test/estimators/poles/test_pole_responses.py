# SPDX-License-Identifier: BSD-3-Clause
"""Responses of poles against SciPy's solver of differential equations, and their derivatives."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from piezo_identification.estimators.dynamics.fast_dynamics import (
    ModeOrder,
    differentiated,
    fast_dynamics_of,
    poles_and_residues,
)
from piezo_identification.estimators.poles.pole_responses import HeldInput
from piezo_models.effects.sensor_lag import SensorLag
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.linear.dynamics import ElectricVibrationDynamics

PERIOD_S = 1e-3
POLES = np.array([-300.0, -80.0 + 900.0j, -80.0 - 900.0j])
ORDER = ModeOrder(2, 1, 2, 1)
VECTOR = np.append(np.log([
    4e-4, 2000.0, 5000.0, 1.4, 0.08, 3500.0, 0.05, 7000.0, 9000.0, 0.02, 0.01, 1e-4]),
    [-0.07, 0.05])
DYNAMICS = ElectricVibrationDynamics(4e-4, (2000.0, 5000.0), (1.4, 0.08), (3500.0,), (0.05,))
BESIDE = VibrationMode(7000.0, 0.02, -0.07), VibrationMode(9000.0, 0.01, 0.05)


@pytest.fixture
def samples():
    return np.random.default_rng(1).normal(size=12)


@pytest.mark.parametrize("delay", [0.0, 0.3, 2.6, -0.4, -1.5])
def test_a_held_input_is_answered_as_by_the_differential_equation(samples, delay):
    found = HeldInput(samples, PERIOD_S, is_periodic=False).responses(POLES, delay).value
    for column, pole in zip(found.T, POLES, strict=True):
        state, ends = -samples[0] / pole, []
        for value in samples:
            solved = solve_ivp(
                lambda _, x, pole=pole, value=value: pole * x + value, (0.0, PERIOD_S),
                [complex(state)], rtol=1e-10, atol=1e-13, dense_output=True)
            ends.append(solved.sol)
            state = solved.y[0, -1]
        for n in range(3, 10):
            hold, part = divmod(n - delay, 1.0)
            assert column[n] == pytest.approx(ends[int(hold)](part * PERIOD_S)[0], rel=1e-6)


def test_a_periodic_input_is_answered_as_after_many_periods(samples):
    once = HeldInput(samples, PERIOD_S, is_periodic=True).responses(POLES, 0.7).value
    many = HeldInput(np.tile(samples, 40), PERIOD_S, is_periodic=False).responses(POLES, 0.7).value
    np.testing.assert_allclose(once, many[-samples.size :], rtol=1e-9)


@pytest.mark.parametrize("delay", [2.6, -1.5])
def test_inputs_one_after_another_do_not_reach_into_each_other(samples, delay):
    other = np.random.default_rng(2).normal(size=9) + 5.0
    joined = HeldInput(np.concatenate([samples, other]), PERIOD_S, False, (0, samples.size))
    apart = [HeldInput(each, PERIOD_S, False).responses(POLES, delay) for each in (samples, other)]
    found = joined.responses(POLES, delay)
    for name in ("value", "by_pole", "by_delay"):
        np.testing.assert_array_equal(
            getattr(found, name), np.concatenate([getattr(each, name) for each in apart]))
    rows = np.array([samples.size - 3, samples.size])
    np.testing.assert_array_equal(joined.responses(POLES, delay, rows).value, found.value[rows])


@pytest.mark.parametrize("is_periodic", [True, False])
def test_the_derivatives_are_those_of_differences(samples, is_periodic):
    held = HeldInput(samples, PERIOD_S, is_periodic)
    answers, step = held.responses(POLES, -0.4), 1e-5
    by_delay = (held.responses(POLES, -0.4 + step).value
                - held.responses(POLES, -0.4 - step).value) / (2.0 * step)
    by_pole = (held.responses(POLES + step, -0.4).value
               - held.responses(POLES - step, -0.4).value) / (2.0 * step)
    inner = slice(1, -2)
    np.testing.assert_allclose(answers.by_delay[inner], by_delay[inner], rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(answers.by_pole, by_pole, rtol=1e-4, atol=1e-12)


@pytest.mark.parametrize("delay", [0.0, 0.3125, 2.625, -0.4375, -1.5])
def test_an_input_between_the_samples_is_answered_as_one_of_finer_samples(samples, delay):
    fine = 16
    late = np.arange(samples.size) * fine - np.array([0, 0, 3, 0, 15, 8, 0, 1, 0, 14, 11, 0])
    finer = np.repeat(samples, np.diff(late, append=samples.size * fine))
    early = np.arange(samples.size) - late / fine
    held = HeldInput(samples, PERIOD_S, False, early=early)
    # Read between the edges, where the derivative by the delay has one value.
    by = 0.5 / fine if delay % 1.0 else 0.0
    found = held.responses(POLES, delay + by)
    wanted = HeldInput(finer, PERIOD_S / fine, False).responses(POLES, (delay + by) * fine)
    inner = slice(2, -2)
    for name, scale in (("value", 1.0), ("by_pole", 1.0), ("by_delay", fine)):
        whole, of_finer = getattr(found, name), scale * getattr(wanted, name)[::fine]
        np.testing.assert_allclose(whole[inner], of_finer[inner], rtol=1e-9, atol=1e-15)
    rows = np.array([3, 4, 8])
    np.testing.assert_allclose(
        held.responses(POLES, delay + by, rows).value, found.value[rows], rtol=1e-12)


def test_poles_and_residues_make_the_response_of_the_model():
    poles, residues, _, _ = differentiated(VECTOR, ORDER)
    frequency_hz = np.geomspace(1.0, 5000.0, 60)
    s = 2j * np.pi * frequency_hz
    found = np.sum(residues / (s[:, None] - poles), axis=1)
    wanted = DYNAMICS.response(frequency_hz, BESIDE) / (1.0 + 1e-4 * s)
    np.testing.assert_allclose(found, wanted, rtol=1e-9)


def test_a_vector_holds_all_of_the_dynamics():
    dynamics, effects = fast_dynamics_of(VECTOR, ORDER)
    frequency_hz = np.array([10.0, 300.0, 900.0])
    np.testing.assert_allclose(
        dynamics.response(frequency_hz), DYNAMICS.response(frequency_hz), rtol=1e-12)
    for effect, wanted in zip(effects, (*BESIDE, SensorLag(1e-4)), strict=True):
        assert effect.parameters() == pytest.approx(wanted.parameters(), rel=1e-12)
    assert str(ORDER) == "2-1+2 lag"


def test_equal_lags_have_a_response_too():
    poles, residues = poles_and_residues(
        np.log([[1e-4, 1e-4]]), ModeOrder(0, sensor_lags=1))
    s = 2j * np.pi * 800.0
    assert np.sum(residues / (s - poles)) == pytest.approx((1.0 + 1e-4 * s) ** -2, rel=1e-4)
