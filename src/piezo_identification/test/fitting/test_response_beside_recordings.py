# SPDX-License-Identifier: BSD-3-Clause
"""A frequency response is fitted together with recordings of slower motion."""

from dataclasses import replace

import numpy as np
import pytest

from piezo_identification import FrequencyResponse, estimate_from_response
from piezo_identification.conditioning.outlier_samples import with_outliers_marked
from piezo_identification.estimators.frequency_response.response_search import ResponseSearch
from piezo_identification.experiments import catalogue as experiments
from piezo_identification.fitting.whole_model import WholeModel
from piezo_models.effects.amplifier_lag import AmplifierLag
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics

NOISE = 2e-3

NOISE_OF_MEANS_UM = 0.009 / 20.0
"""Noise of rows that are means of 400 samples."""


def factor(plant, s):
    """Creep, lag and modes of the plant as polynomials in s."""
    response = 1.0 / (1.0 + plant.dynamics.time_constant_s * s)
    for pole, zero in zip(plant.creep.poles_rad_per_s, plant.creep.zeros_rad_per_s, strict=True):
        response = response * (s + zero) / (s + pole)
    for mode, damping in zip(
            plant.dynamics.mode_frequencies_rad_per_s, plant.dynamics.damping_ratios, strict=True):
        response = response / (1.0 + 2.0 * damping * s / mode + (s / mode) ** 2)
    return response


@pytest.fixture(scope="module")
def measured(plant):
    """The response of the plant, of another gain than its loops have, with relative noise."""
    frequency_hz = np.geomspace(1.0, 2000.0, 150)
    draw = np.random.default_rng(5).normal(size=(2, frequency_hz.size))
    gain = 0.4 * factor(plant, 2j * np.pi * frequency_hz)
    return FrequencyResponse("response.csv", frequency_hz, gain * (
        1.0 + NOISE * (draw[0] + 1j * draw[1])))


@pytest.fixture(scope="module")
def slow(play):
    return with_outliers_marked(play(experiments.creep(period_s=60.0), 1, 100.0))


@pytest.fixture(scope="module")
def fitted(plant, measured, slow):
    wrong = replace(
        plant, creep=CreepDynamics((0.0145, 0.165, 1.08, 17.0), (0.0149, 0.1685, 1.1, 17.8)),
        dynamics=ElectricVibrationDynamics(0.0005, (2800.0, 4930.0), (0.70, 0.085)))
    problem = WholeModel(
        wrong, [slow], [0.0], responses=[ResponseSearch(measured).measured_response()])
    return problem, problem.fit(wrong, None, 8)


def test_both_are_explained_to_their_noise(fitted):
    problem, fit = fitted
    assert np.std(fit.residual_um[0][0]) == pytest.approx(NOISE_OF_MEANS_UM, rel=0.1)
    assert problem.over_noise(fit)[1] == pytest.approx(1.0, abs=0.15)


def test_the_response_gives_the_dynamics_and_the_recording_the_slow_creep(plant, fitted):
    fit = fitted[1]
    deviations = fit.deviations()[0]
    for part, names in (("dynamics", ("time_constant_s", "mode_frequencies_rad_per_s",
                                      "damping_ratios")), ("creep", ("poles_rad_per_s",))):
        for name in names:
            value = np.array(getattr(getattr(fit.model, part), name))
            spread = np.array(deviations[part][name])
            assert np.all(np.abs(value - getattr(getattr(plant, part), name)) < 4.0 * spread), name
    mode = deviations["dynamics"]["mode_frequencies_rad_per_s"]
    assert np.all(np.array(mode) < 2e-3 * np.array(plant.dynamics.mode_frequencies_rad_per_s))


def test_a_lag_in_front_of_the_hysteresis_is_part_of_the_response(plant):
    frequency_hz = np.geomspace(1.0, 1000.0, 20)
    s = 2j * np.pi * frequency_hz
    lagging = replace(plant, effects=(AmplifierLag(3e-4),))
    expected = factor(plant, s) / (1.0 + 3e-4 * s)
    np.testing.assert_allclose(lagging.small_signal_response(frequency_hz), expected, rtol=1e-9)


def test_the_loss_of_hysteresis_at_small_signals_is_not_taken_for_creep():
    """Sines of any frequency lag by 3 degrees; the stage has a mode and no creep."""
    frequency_hz = np.geomspace(1.0, 500.0, 60)
    s = 2j * np.pi * frequency_hz
    plain = 0.3 / (1.0 + 0.04 * s / 900.0 + (s / 900.0) ** 2)
    noise = np.random.default_rng(2).normal(size=(2, 60))
    measured = FrequencyResponse("response.csv", frequency_hz, plain * np.exp(-0.05j) * (
        1.0 + NOISE * (noise[0] + 1j * noise[1])))
    found = estimate_from_response(measured, has_loss=True).model
    assert found.creep.poles_rad_per_s == ()
    assert found.dynamics.mode_frequencies_rad_per_s == pytest.approx((900.0,), rel=1e-3)
    np.testing.assert_allclose(found.response(frequency_hz), plain, rtol=0.01)
    as_linear = estimate_from_response(measured).model
    assert np.abs(as_linear.response(frequency_hz) / plain - 1.0).max() > 0.03


def test_parallel_modes_of_the_response_may_be_far_above_the_rate_of_the_rows(
        plant, measured, slow):
    mode = VibrationMode(9000.0, 0.02, 0.2)
    s = 2j * np.pi * measured.frequency_hz
    own, other = (1.0 / (1.0 + 2.0 * damping * s / frequency + (s / frequency) ** 2)
                  for frequency, damping in ((4909.0, 0.082), (9000.0, 0.02)))
    of_lag = factor(plant, s) / own * (1.0 + 2.0 * 0.685 * s / 2846.0 + (s / 2846.0) ** 2)
    one_mode = replace(plant, dynamics=ElectricVibrationDynamics(0.00049, (4909.0,), (0.082,)))
    both = replace(measured, gain=0.4 * of_lag * (0.8 * own + 0.2 * other))
    model = replace(one_mode, effects=(replace(mode, frequency_rad_per_s=9010.0),))
    problem = WholeModel(
        model, [slow], [0.0], responses=[ResponseSearch(both).measured_response()])
    found, = problem.fit(model, None, 8).model.effects
    assert found.frequency_rad_per_s == pytest.approx(9000.0, rel=1e-4)
    assert found.damping_ratio == pytest.approx(0.02, rel=1e-2)
