# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import replace

import control
import numpy as np
import pytest
from slycot import sb10ad

from piezo_controller.feedback_design import design_feedback, design_plant, generalised_plant
from piezo_controller.h_infinity import NoController, close, is_stable, synthesise
from piezo_controller.lifted_plant import lift
from piezo_controller.loop_measures import loop_responses, measure_loop
from piezo_controller.weights import load_weights
from piezo_models.linear import simulate_linear, zoh

TICK_S, CLOCK_PERIOD_S, SAMPLES = 1e-3, 25e-6, 40


@pytest.fixture(scope="module")
def problem(stage_model):
    plant, gain_um_per_v = design_plant(stage_model, TICK_S, CLOCK_PERIOD_S)
    return generalised_plant(plant, gain_um_per_v, load_weights())


@pytest.fixture(scope="module")
def solution(problem):
    return synthesise(problem)


@pytest.fixture(scope="module")
def controller(stage_model):
    return design_feedback(stage_model, load_weights())


def test_lifted_plant_is_the_fast_simulation_with_hold_mean_and_delay(stage_model):
    fast = zoh(stage_model.linear(), CLOCK_PERIOD_S)
    decided_v = np.random.default_rng(1).normal(size=60)
    acting_v = np.r_[0.0, decided_v[:-1]]
    mean_um = simulate_linear(fast, np.repeat(acting_v, SAMPLES)).reshape(-1, SAMPLES).mean(1)
    known_um = np.r_[0.0, mean_um[:-1]]
    lifted_um = simulate_linear(lift(fast, SAMPLES), decided_v)
    np.testing.assert_allclose(lifted_um, known_um, atol=1e-12)


def test_closed_loop_norm_is_that_of_a_dense_frequency_sweep_and_within_gamma(problem, solution):
    controller, gamma = solution
    closed = close(problem, controller)
    assert is_stable(closed)
    angles = np.r_[0.0, np.geomspace(1e-7, np.pi, 20000)]
    responses = np.moveaxis(closed(np.exp(1j * angles)), -1, 0)
    swept = np.linalg.norm(responses, ord=2, axis=(1, 2)).max()
    assert swept <= gamma * (1 + 1e-6)
    assert control.linfnorm(closed)[0] == pytest.approx(swept, rel=1e-3)


def test_bisection_ends_where_the_bilinear_continuous_synthesis_ends(problem, solution):
    a, b, c, d = bilinear(problem)
    outputs, inputs = d.shape
    gamma = sb10ad(len(a), inputs, outputs, 1, 1, 10.0, a, b, c, d, job=1, gtol=1e-6)[0]
    assert solution[1] == pytest.approx(gamma, rel=1e-3)


def bilinear(system):
    """The continuous system that has the discrete one's values under z = (1 + s) / (1 - s)."""
    a, b, c, d = system.A, system.B, system.C, system.D
    inverse = np.linalg.inv(np.eye(len(a)) + a)
    root = np.sqrt(2)
    return inverse @ (a - np.eye(len(a))), root * inverse @ b, root * c @ inverse, (
        d - c @ inverse @ b)


def test_bilinear_of_the_test_keeps_the_response(problem):
    s = 0.3j
    a, b, c, d = bilinear(problem)
    response = c @ np.linalg.solve(s * np.eye(len(a)) - a, b) + d
    np.testing.assert_allclose(response, problem((1 + s) / (1 - s)), rtol=1e-7, atol=1e-9)


def test_generalised_plant_is_the_sum_of_its_weighted_paths(problem, stage_model):
    weights = load_weights()
    z = np.exp(2j * np.pi * 30 * TICK_S)
    plant, k_h = design_plant(stage_model, TICK_S, CLOCK_PERIOD_S)
    loop = k_h * plant(z)
    w1, w2, w_n, w_d = (getattr(weights, name).state_space(TICK_S)(z)
                        for name in ("performance", "control", "noise", "disturbance"))
    errors = np.array([-loop, -0.05, -w_d, 0, -loop])
    expected = [[0, 0, 0, 0, 0.12], w1 * errors, [0, 0, 0, 0, w2], errors - [0, 0, 0, w_n, 0]]
    np.testing.assert_allclose(problem(z), np.array(expected), atol=1e-9)


def test_slack_is_given_up_and_calms_the_controller(problem, solution):
    optimal, gamma = solution
    relaxed, bound = synthesise(problem, slack=0.1)
    assert bound == pytest.approx(1.1 * gamma)
    assert control.linfnorm(close(problem, relaxed))[0] <= bound * (1 + 1e-6)
    above_150_hz = np.exp(1j * np.linspace(0.3 * np.pi, np.pi, 500))
    peaks = [np.abs(c(above_150_hz, squeeze=True)).max() for c in (optimal, relaxed)]
    assert peaks[1] < 0.6 * peaks[0]


def test_default_design_meets_what_the_loop_is_for(controller):
    report = controller.report
    assert report["closed_loop_norm"] <= report["gamma"] * (1 + 1e-6) < 1
    assert report["order"] == len(controller.A) <= 20
    assert 35 < report["bandwidth_hz"] < 50
    assert report["peak_sensitivity"] < 2.8
    assert report["settling_to_5_percent_s"] <= 0.012
    assert report["stable_within_gain_spread"]


def test_measures_of_a_loop_known_in_closed_form():
    # L = k / (z - 1): S = (z - 1) / (z - 1 + k).
    gain = 0.2
    integrator = control.ss(1.0, 1.0, gain, 0.0, TICK_S)
    unit = control.ss([], [], [], [[1.0]], TICK_S)
    measures = measure_loop(integrator, unit, 0.1)
    assert measures["gain_margin"] == pytest.approx(2 / gain, rel=1e-2)
    crossing_rad = 2 * np.arcsin(gain / 2)
    assert measures["phase_margin_deg"] == pytest.approx(
        90 - np.degrees(crossing_rad) / 2, abs=0.2)
    assert measures["peak_sensitivity"] == pytest.approx(2 / (2 - gain), rel=1e-4)
    assert measures["settling_to_5_percent_s"] == pytest.approx(14 * TICK_S)
    band = np.exp(2j * np.pi * measures["bandwidth_hz"] * TICK_S) - 1
    assert abs(band / (band + gain)) == pytest.approx(np.sqrt(0.5), rel=2e-3)


def test_unstable_gain_within_the_spread_is_reported(controller, stage_model):
    plant, k_h = design_plant(stage_model, TICK_S, CLOCK_PERIOD_S)
    margin = controller.report["gain_margin"]
    state_space = controller.state_space()
    assert measure_loop(k_h * plant, state_space, 0.98 * (margin - 1))["stable_within_gain_spread"]
    assert not measure_loop(k_h * plant, state_space,
                            1.02 * (margin - 1))["stable_within_gain_spread"]


def test_smaller_performance_weight_lowers_the_peak_and_raises_the_sensitivity_in_band(
        controller, stage_model):
    weights = load_weights()
    softer = design_feedback(stage_model, replace(
        weights, performance=replace(weights.performance, gain=0.06)))
    plant, k_h = design_plant(stage_model, TICK_S, CLOCK_PERIOD_S)
    at_40_hz = [abs(loop_responses(k_h * plant, c.state_space(), [40.0])[1][0])
                for c in (controller, softer)]
    assert at_40_hz[0] < at_40_hz[1]
    assert softer.report["peak_sensitivity"] < controller.report["peak_sensitivity"]


def test_demand_beyond_reach_is_refused(problem):
    with pytest.raises(NoController, match="relax the weights"):
        synthesise(problem, largest_norm=0.01)


def test_tick_that_is_no_multiple_of_the_clock_is_refused(stage_model):
    with pytest.raises(ValueError, match="no multiple"):
        design_plant(stage_model, 1.01e-3, CLOCK_PERIOD_S)
