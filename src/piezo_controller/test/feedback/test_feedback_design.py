# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import replace

import control
import numpy as np
import pytest
from slycot import sb10ad

from piezo_controller.feedback.feedback_design import (
    design_feedback,
    structured_singular_value,
)
from piezo_controller.feedback.loop_measures import loop_responses, measure_loop
from piezo_controller.feedback.robustness import plant_errors
from piezo_controller.feedback.synthesis.dk_iteration import scale
from piezo_controller.feedback.synthesis.generalised_plant import (
    design_plant,
    generalised_plant,
    hysteresis_gain_range,
    lift,
)
from piezo_controller.feedback.synthesis.h_infinity import (
    NoController,
    close,
    is_stable,
    reduce_order,
    synthesise,
)
from piezo_controller.feedback.synthesis.weights import load_weights
from piezo_models.effects.bouc_wen_hysteresis import BoucWenHysteresis
from piezo_models.effects.curved_bouc_wen_hysteresis import CurvedBoucWenHysteresis
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import simulate_linear, zoh

pytestmark = pytest.mark.kernels

TICK_S, CLOCK_PERIOD_S, SAMPLES = 1e-3, 25e-6, 40


@pytest.fixture(scope="module")
def unscaled_problem(stage_model):
    plant, gain_um_per_v = design_plant(stage_model, TICK_S, CLOCK_PERIOD_S)
    return generalised_plant(plant, gain_um_per_v, load_weights("thesis"))


@pytest.fixture(scope="module")
def problem(unscaled_problem):
    # Near the scalings that the D-K iteration ends with.
    return scale(unscaled_problem, [1.2, 0.5])


@pytest.fixture(scope="module")
def solution(problem):
    return synthesise(problem)


@pytest.fixture(scope="module")
def controller(stage_model):
    """Return the default design, with all scalings that users get."""
    return design_feedback(stage_model, load_weights())


@pytest.fixture(scope="module")
def thesis_controller(stage_model):
    return design_feedback(stage_model, load_weights("thesis"))


@pytest.mark.parametrize("delay_ticks", [0, 1, 2])
def test_lifted_plant_is_the_fast_simulation_with_hold_mean_and_delay(stage_model, delay_ticks):
    fast = zoh(stage_model.linear(), CLOCK_PERIOD_S)
    decided_v = np.random.default_rng(1).normal(size=60)
    acting_v = np.r_[np.zeros(delay_ticks), decided_v[:60 - delay_ticks]]
    mean_um = simulate_linear(fast, np.repeat(acting_v, SAMPLES)).reshape(-1, SAMPLES).mean(1)
    known_um = np.r_[0.0, mean_um[:-1]]
    lifted_um = simulate_linear(lift(fast, SAMPLES, delay_ticks), decided_v)
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
    """Return continuous system that has the discrete one's values under z = (1 + s) / (1 - s)."""
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


def test_generalised_plant_is_the_sum_of_its_weighted_paths(unscaled_problem, stage_model):
    weights = load_weights("thesis")
    z = np.exp(2j * np.pi * 30 * TICK_S)
    plant, k_h = design_plant(stage_model, TICK_S, CLOCK_PERIOD_S)
    loop = k_h * plant(z)
    w1, w2, w_n, w_d = (getattr(weights, name).state_space(TICK_S)(z)
                        for name in ("performance", "control", "noise", "disturbance"))
    errors = np.array([-loop, -0.05, 0, -w_d, 0, -loop])
    expected = [[0, 0, 0, 0, 0, 0.12], [0, 0, 1, 0, 0, 0], w1 * errors, [0, 0, 0, 0, 0, w2],
                errors - [0, 0, 0, 0, w_n, 0]]
    np.testing.assert_allclose(unscaled_problem(z), np.array(expected), atol=1e-9)


def test_slack_is_given_up_and_calms_the_controller(problem, solution):
    optimal, gamma = solution
    relaxed, bound = synthesise(problem, slack=0.1)
    assert bound == pytest.approx(1.1 * gamma)
    assert control.linfnorm(close(problem, relaxed))[0] <= bound * (1 + 1e-6)
    above_150_hz = np.exp(1j * np.linspace(0.3 * np.pi, np.pi, 500))
    peaks = [np.abs(c(above_150_hz, squeeze=True)).max() for c in (optimal, relaxed)]
    assert peaks[1] < 0.6 * peaks[0]


def test_controllers_are_stable_themselves(solution, controller, thesis_controller):
    for found in solution[0], controller.state_space(), thesis_controller.state_space():
        assert is_stable(found)


def test_designs_meet_what_the_loop_is_for(controller, thesis_controller):
    for report, largest_mu in (controller.report, 0.81), (thesis_controller.report, 0.90):
        assert report["mu"] <= largest_mu
        assert report["mu"] <= report["gamma"] * 1.01
        assert 35 < report["bandwidth_hz"] < 50
        assert report["settling_to_5_percent_s"] <= 0.015
        assert report["stable_within_gain_spread"]
        assert report["gain_margin_at_lowest_gain"] > report["gain_margin"] \
            > report["gain_margin_at_highest_gain"] > 1.3
        assert report["order"] < report["order_before_reduction"] == 17


@pytest.mark.long
def test_thesis_weights_without_delay_and_mean_give_its_order_and_less_than_its_mu(stage_model):
    # At the thesis' hysteresis gain.
    low, high = hysteresis_gain_range(stage_model)
    factor = 0.96 / ((low + high) / 2)
    hysteresis = stage_model.hysteresis
    model = replace(stage_model, hysteresis=replace(
        hysteresis, density_um_per_v2=factor * hysteresis.density_um_per_v2))
    for scaling, largest_mu in ("constant", 0.70), ("dynamic", 0.68):
        report = design_feedback(model, load_weights("thesis"), at_once=True, scaling=scaling,
                                 reduce=False).report
        assert report["hysteresis_gain_um_per_v"] == pytest.approx(0.96)
        assert report["mu"] <= largest_mu
        assert report["settling_to_5_percent_s"] <= 0.015
        if scaling == "constant":
            assert report["order"] == 15
    assert min(report["mu_history"]) == pytest.approx(0.627, abs=0.005)


def test_default_weights_reject_what_the_thesis_ask_for_below_20_hz_with_a_lower_peak(
        controller, thesis_controller, stage_model):
    weights = load_weights("thesis")
    plant, k_h = design_plant(stage_model, TICK_S, CLOCK_PERIOD_S)
    frequency_hz = np.geomspace(0.1, 20.0, 50)
    points = np.exp(2j * np.pi * frequency_hz * TICK_S)
    asked = np.abs(weights.performance.state_space(TICK_S)(points, squeeze=True)
                   * weights.disturbance.state_space(TICK_S)(points, squeeze=True))
    _, sensitivity = loop_responses(k_h * plant, controller.state_space(), frequency_hz)
    assert np.max(asked * np.abs(sensitivity)) <= 0.81
    assert controller.report["peak_sensitivity"] \
        < 0.95 * thesis_controller.report["peak_sensitivity"]


def test_loop_endures_the_gain_range_and_errors_of_every_parameter(controller, stage_model):
    errors = plant_errors(stage_model, TICK_S, CLOCK_PERIOD_S, 0.12)
    found = errors.robustness(controller.state_space(), samples=40)
    assert found.stable and found.samples == 40
    assert controller.report["peak_sensitivity"] < found.worst_peak_sensitivity < 4


def test_errors_that_the_loop_does_not_endure_are_found(controller, stage_model):
    margin = controller.report["gain_margin"]
    errors = plant_errors(stage_model, TICK_S, CLOCK_PERIOD_S, 1.05 * (margin - 1))
    found = errors.robustness(controller.state_space(), samples=20)
    assert not found.stable
    assert np.isinf(found.worst_peak_sensitivity)


def test_reduction_keeps_what_is_acceptable_and_drops_a_state_that_does_nothing(unscaled_problem):
    controller = control.ss(np.diag([0.5, 0.9, 0.3]), [[1.0], [1.0], [1e-9]], [[1.0, 1.0, 1e-9]],
                            0.0, TICK_S)
    asked = []

    def acceptable(candidate):
        asked.append(candidate.nstates)
        return candidate.nstates >= 2

    reduced = reduce_order(controller, acceptable)
    assert (asked, reduced.nstates, reduced.dt) == ([2, 1], 2, TICK_S)
    assert reduced(1j) == pytest.approx(controller(1j))


def test_reduced_controller_costs_no_more_than_a_hundredth_of_mu(thesis_controller,
                                                                  unscaled_problem):
    before = thesis_controller.report["mu_history"][-1]
    _, mu = structured_singular_value(unscaled_problem, thesis_controller.state_space())
    assert thesis_controller.report["mu"] == pytest.approx(mu.max())
    assert mu.max() <= before * 1.0101


@pytest.mark.parametrize("method, order", [("pid", 2), ("pi", 1)])
def test_ziegler_nichols_gives_a_stable_loop_with_an_integrator(stage_model, method, order):
    report = design_feedback(stage_model, load_weights(), method=method).report
    assert report["order"] == order
    assert report["stable_within_gain_spread"]
    assert report["bandwidth_hz"] > 30


def test_unknown_method_is_refused(stage_model):
    with pytest.raises(ValueError, match="unknown method 'lqg'"):
        design_feedback(stage_model, load_weights(), method="lqg")


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


def static_loop(gain, delay=0):
    """Return the loop L = gain / z^delay."""
    return control.ss(np.eye(delay, k=-1), np.eye(delay, 1), gain * np.eye(1, delay, delay - 1),
                      [[0.0 if delay else gain]], TICK_S)


def measured(loop):
    return measure_loop(loop, control.ss([], [], [], [[1.0]], TICK_S), 0.1)


def test_a_loop_that_never_reaches_one_has_no_crossover():
    # S = 1 / (1 + 1 / 2z): |1 + e^-jw / 2|^2 = 2 where cos w = 3/4.
    measures = measured(static_loop(0.5, delay=1))
    assert measures["crossover_hz"] is None
    assert measures["phase_margin_deg"] is None
    assert measures["gain_margin"] == pytest.approx(2.0)
    assert measures["bandwidth_hz"] == pytest.approx(
        np.arccos(0.75) / (2 * np.pi * TICK_S), rel=2e-3)
    # So weak a loop suppresses nothing to -3 dB: S(0) = 1 / 1.1.
    weak = measured(static_loop(0.1, delay=1))
    assert weak["bandwidth_hz"] is None
    assert weak["crossover_hz"] is None


def test_a_loop_that_never_falls_has_no_crossover_and_no_margins():
    measures = measured(static_loop(3.0))
    for name in ("crossover_hz", "bandwidth_hz", "gain_margin", "phase_margin_deg"):
        assert measures[name] is None, name
    assert measures["peak_sensitivity"] == pytest.approx(0.25)


def test_the_crossover_is_where_the_loop_falls_and_not_where_it_rises():
    # |L| = g / |z^2 - 2 r cos(a) z + r^2|, a resonance that stands out of a low gain.
    radius, angle, gain = 0.99, 0.5, 0.02
    resonance = control.ss([[2 * radius * np.cos(angle), -radius**2], [1, 0]], [[1], [0]],
                           [[0, gain]], [[0]], TICK_S)
    turn = np.linspace(1e-3, np.pi, 2_000_000)
    z = np.exp(1j * turn)
    size = gain / np.abs(z**2 - 2 * radius * np.cos(angle) * z + radius**2)
    assert size[0] < 1 < size.max()
    falls = turn[1:][(size[:-1] >= 1) & (size[1:] < 1)]
    assert measured(resonance)["crossover_hz"] == pytest.approx(
        falls[0] / (2 * np.pi * TICK_S), rel=2e-3)


def test_a_loop_that_does_not_settle_has_no_settling_time():
    slow = control.ss(1.0, 1.0, 1e-5, 0.0, TICK_S)  # 0.05 left after 300 s
    assert measured(slow)["settling_to_5_percent_s"] is None


def test_unstable_gain_within_the_spread_is_reported(controller, stage_model):
    plant, k_h = design_plant(stage_model, TICK_S, CLOCK_PERIOD_S)
    margin = controller.report["gain_margin"]
    state_space = controller.state_space()
    assert measure_loop(k_h * plant, state_space, 0.98 * (margin - 1))["stable_within_gain_spread"]
    assert not measure_loop(k_h * plant, state_space,
                            1.02 * (margin - 1))["stable_within_gain_spread"]


def test_demand_beyond_reach_is_refused(problem):
    with pytest.raises(NoController, match="relax the weights"):
        synthesise(problem, largest_norm=0.01)


@pytest.mark.parametrize("kind", [BoucWenHysteresis, CurvedBoucWenHysteresis])
def test_gain_range_contains_the_slopes_of_the_loops_of_a_bouc_wen_hysteresis(stage_model, kind):
    line = PreisachModel.line(0.0, 100.0, 0.2)
    loops = kind(5.0, 20.0, 0.5)
    model = replace(stage_model, hysteresis=line, effects=(loops,))
    turns_v = np.interp(np.linspace(0.0, 6.0, 6001), np.arange(7), [0, 100, 0, 100, 50, 100, 0])
    moved_um = line.simulate(loops.apply(turns_v, 1.0))
    slopes = np.diff(moved_um) / np.diff(turns_v)
    near = np.abs(turns_v[1:] - 50.0) < 1.0
    low, high = hysteresis_gain_range(model)
    assert low - 1e-3 < slopes[near].min() < 1.05 * low
    assert 0.97 * high < slopes[near].max() < high + 1e-3


def test_tick_that_is_no_multiple_of_the_clock_is_refused(stage_model):
    with pytest.raises(ValueError, match="no multiple"):
        design_plant(stage_model, 1.01e-3, CLOCK_PERIOD_S)
