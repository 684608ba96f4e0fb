# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from piezo_models.linear.dynamics import (
    ElectricVibrationDynamics,
    simulate_linear,
    zoh,
    zoh_response,
)
from piezo_models.linear.dynamics_vector import dynamics_vector
from piezo_studies.baselines.armax import _PredictionErrors, fit_armax, identify_subspace
from piezo_studies.baselines.armax_dynamics import dynamics_of_armax

ONE_MODE = ElectricVibrationDynamics(0.001, (3000.0,), (0.1,))
TWO_MODES = ElectricVibrationDynamics(0.00049, (2846.0, 4909.0), (0.685, 0.082))


def square_record(dynamics, sample_period_s, period_s, periods, swing_um):
    """Square wave and response after two periods of settling."""
    half = round(0.5 * period_s / sample_period_s)
    wave = np.tile(np.repeat([0.5, -0.5], half), periods + 2)
    response = swing_um * simulate_linear(zoh(dynamics.state_space(), sample_period_s), wave)
    return wave[4 * half :], response[4 * half :]


def normalised_errors(dynamics, orders, sample_period_s, period_s, periods, swing_um, noise_um):
    """Response errors, and parameter errors over truth and over their predicted spread."""
    wave, clean = square_record(dynamics, sample_period_s, period_s, periods, swing_um)
    frequency_hz = np.geomspace(5.0, 1000.0, 40)
    truth = swing_um * zoh_response(dynamics.state_space(), frequency_hz, sample_period_s)
    response_errors, relative, normalised = [], [], []
    for seed in range(20):
        noise = noise_um * np.random.default_rng(seed).normal(size=clean.size)
        armax = fit_armax(wave, clean + noise, *orders)
        off = armax.response(frequency_hz, sample_period_s) - truth
        response_errors.append(np.linalg.norm(off) / np.linalg.norm(truth))
        modes = len(dynamics.damping_ratios)
        model, spread = dynamics_of_armax(armax, wave, sample_period_s, modes)
        error = dynamics_vector(model) - dynamics_vector(dynamics)
        relative.append(error / dynamics_vector(dynamics))
        normalised.append(error / np.concatenate([np.ravel(value) for value in spread.values()]))
    return np.array(response_errors), np.array(relative), np.array(normalised)


@pytest.mark.parametrize(("dynamics", "orders", "record"), [
    (ONE_MODE, (3, 3, 3), (1e-4, 0.1, 2, 8.75, 0.07)),
    pytest.param(ONE_MODE, (5, 6, 5), (1e-4, 0.1, 2, 8.75, 0.07), marks=pytest.mark.long),
    pytest.param(TWO_MODES, (5, 6, 5), (5e-5, 0.02, 20, 10.0, 0.07), marks=pytest.mark.long),
])
def test_white_noise_square_waves_succeed_whatever_the_seed(dynamics, orders, record):
    response_errors, relative, normalised = normalised_errors(dynamics, orders, *record)
    assert np.count_nonzero(response_errors < 0.01) >= 19
    assert np.count_nonzero(np.abs(relative).max(axis=1) < 0.05) >= 19
    # 20 draws: the ratio of empirical to predicted spread has a spread of a sixth itself.
    assert np.sqrt(np.mean(normalised**2, axis=0)) == pytest.approx(1.0, abs=0.6)


def test_coloured_noise_is_modelled_and_does_not_bias():
    rng = np.random.default_rng(3)
    input, white = rng.normal(size=(2, 4000))
    output = np.zeros(4000)
    noise = white + 0.6 * np.append(0.0, white[:-1])
    for n in range(2, 4000):
        output[n] = 1.5 * output[n - 1] - 0.7 * output[n - 2] + input[n - 1] + 0.5 * input[n - 2]
        output[n] += noise[n]
    armax = fit_armax(input, output, 2, 2, 1)
    found = np.concatenate([armax.autoregressive[1:], armax.input[1:], armax.noise[1:]])
    spread = np.sqrt(np.diag(armax.covariance))
    assert np.abs((found - [-1.5, 0.7, 1.0, 0.5, 0.6]) / spread).max() < 4.0
    assert np.std(armax.residual) == pytest.approx(1.0, rel=0.05)


def test_the_jacobian_is_that_of_the_errors():
    rng = np.random.default_rng(1)
    record = _PredictionErrors(*rng.normal(size=(2, 60)), (2, 3, 2), np.ones((60, 1)))
    point = np.array([-1.2, 0.5, 0.3, 0.2, 0.1, -0.4, 0.2, 0.5, -0.3, 0.1, 0.7])
    jacobian = record.errors(point)[1]
    for column, step in zip(jacobian.T, 1e-6 * np.eye(point.size), strict=True):
        difference = record.errors(point + step)[0] - record.errors(point - step)[0]
        np.testing.assert_allclose(column, difference / 2e-6, atol=1e-7)


def test_the_subspace_finds_poles_without_a_guess():
    wave, response = square_record(ONE_MODE, 1e-4, 0.02, 40, 10.0)
    noisy = response + 0.001 * np.random.default_rng(0).normal(size=response.size)
    system = identify_subspace(wave, noisy - noisy.mean(), 3)
    poles = np.sort_complex(np.log(np.linalg.eigvals(system.transition).astype(complex)) / 1e-4)
    truth = np.sort_complex(ONE_MODE.state_space().poles())
    np.testing.assert_allclose(poles, truth, rtol=0.02)


def test_more_modes_than_poles_are_refused():
    wave, response = square_record(ONE_MODE, 1e-4, 0.02, 40, 10.0)
    armax = fit_armax(wave, response + 1e-3 * np.random.default_rng(0).normal(size=wave.size),
                      3, 3, 3)
    with pytest.raises(ValueError, match="order 3 shows no lag besides 2 modes"):
        dynamics_of_armax(armax, wave, 1e-4, 2)


def test_a_record_too_short_for_the_order_is_refused():
    with pytest.raises(ValueError, match="100 samples are too few"):
        fit_armax(np.ones(100), np.ones(100), 5, 5, 5)
