# SPDX-License-Identifier: BSD-3-Clause
"""Feedbacks of fixed order that are tuned over all stages, against formulas and python-control."""

from dataclasses import replace

import control
import numpy as np
import pytest

from piezo_controller.feedback.controller_file import load_stabilising_controller, save_controller
from piezo_controller.feedback.sample_rate.demands import Demands
from piezo_controller.feedback.sample_rate.fast_design import design_at_sample_rate
from piezo_controller.feedback.sample_rate.fixed_order import FixedOrder
from piezo_controller.feedback.sample_rate.minimax import Linearised, lower_largest
from piezo_controller.feedback.sample_rate.perturbed_loops import ModelErrors, PerturbedLoops
from piezo_controller.feedback.sample_rate.tuned_over_stages import (
    LoopProblem,
    tuned_family,
)
from piezo_controller.feedback.synthesis.generalised_plant import (
    hysteresis_gain_range,
    nominal_hysteresis_gain,
)
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics

PERIOD_S = 25e-6
FIRST_MODE_HZ = 2846.0 / (2 * np.pi)


@pytest.fixture(scope="module")
def model():
    """Return the thesis' creep and dynamics behind a hysteresis whose gain varies by 12 %."""
    centres_v = np.linspace(-20.0, 120.0, 31)[:-1] + 140.0 / 60
    width_v = centres_v[:, None] - centres_v[None, :]
    density = np.tril(1.98e-3 + 0.078 * np.exp(-((width_v / 12.0) ** 2)))
    return StageModel(
        PreisachModel(-20.0, 120.0, density, -9.7),
        CreepDynamics((0.01419, 0.1680, 0.2348, 1.0525, 17.566),
                      (0.01459, 0.1711, 0.2357, 1.0695, 18.285)),
        ElectricVibrationDynamics(0.00049, (2846.0, 4909.0), (0.68535, 0.081992)))


def start_of(model, demands):
    """Return family, numbers and loops of where a tuning begins."""
    family = tuned_family(model, demands, PERIOD_S)
    loops = PerturbedLoops(model, demands.errors, PERIOD_S, demands.disturbance_hz,
                           demands.disturbance_tolerance, delay_ticks=0)
    return family, family.start, loops


def test_every_stage_meets_the_demands_with_its_light_mode_off_by_twenty_percent(model):
    demands = Demands(errors=ModelErrors(0.05, 0.20), of_every_stage=True)
    family, numbers, loops = start_of(model, demands)
    figures = loops.measure(family.controller(numbers))
    assert demands.margin_db(figures, FIRST_MODE_HZ) > 0.0
    assert demands.violation_db(figures) < 0.3


def drawn_loop(model, rng, controller, frequency_hz, light):
    """Return the loop of a stage with errors, by the thesis' formulas (4.3) and (4.4)."""
    s = 2j * np.pi * frequency_hz
    lag, first, damping, light_damping = 1 + rng.uniform(-0.05, 0.05, 4)
    response = rng.uniform(*hysteresis_gain_range(model)) / (0.00049 * lag * s + 1)
    for mode, ratio in ((2846.0 * first, 0.68535 * damping),
                        (4909.0 * light, 0.081992 * light_damping)):
        response = response / ((s / mode) ** 2 + 2 * ratio * s / mode + 1)
    for pole, zero in zip(model.creep.poles_rad_per_s, model.creep.zeros_rad_per_s, strict=True):
        response = response * (s + zero) / (s + pole)
    hold = (1 - np.exp(-s * PERIOD_S)) / (s * PERIOD_S)
    return response * hold * np.exp(-s * PERIOD_S) * controller


def test_stages_between_the_corners_keep_peak_bandwidth_and_attenuation(model):
    demands = Demands(errors=ModelErrors(0.05, 0.20), of_every_stage=True)
    family, numbers, _ = start_of(model, demands)
    frequency_hz = np.unique(np.concatenate([
        np.geomspace(1.0, 19_000.0, 1500), np.linspace(49.5, 50.5, 9), np.linspace(99, 101, 9)]))
    points = np.exp(2j * np.pi * frequency_hz * PERIOD_S)
    controller = family.controller(numbers)(points, squeeze=True)
    rng = np.random.default_rng(3)
    for light in np.linspace(0.8, 1.2, 81):
        loop = drawn_loop(model, rng, controller, frequency_hz, light)
        sensitivity = 1 / (1 + loop)
        # No encirclement of -1: the angle of 1 + L comes back to where the integration began.
        turned = np.unwrap(np.angle(1 + loop))
        assert abs(turned[-1] - turned[0] - np.pi / 2) < 0.5
        assert np.abs(sensitivity).max() < 1.04 * demands.worst_peak_sensitivity
        below = frequency_hz[np.abs(loop * sensitivity) < np.sqrt(0.5)]
        assert below[0] > 1.2 * FIRST_MODE_HZ
        for hz, asked_db in ((50.0, 30.0), (100.0, 20.0)):
            band = np.abs(frequency_hz / hz - 1) < 0.0101
            assert -20 * np.log10(np.abs(sensitivity[band]).max()) > asked_db - 0.1


def test_the_derivatives_are_those_of_differences(model):
    demands = Demands(errors=ModelErrors(0.05, 0.20), of_every_stage=True)
    family, numbers, loops = start_of(model, demands)
    problem = LoopProblem(loops, demands, family.structure, FIRST_MODE_HZ,
                          nominal_hysteresis_gain(model))
    here = problem.linearise(numbers)
    rng = np.random.default_rng(0)
    for _ in range(5):
        direction = 1e-6 * rng.normal(size=numbers.size)
        ahead, behind = problem.linearise(numbers + direction), problem.linearise(
            numbers - direction)
        np.testing.assert_allclose(ahead.values - behind.values, 2 * here.slopes @ direction,
                                   atol=1e-8)
        # Which frequencies are peaks may change; the noise stands last.
        np.testing.assert_allclose((ahead.bounds - behind.bounds)[-2:],
                                   2 * (here.bound_slopes @ direction)[-2:], atol=1e-8)


def test_a_controller_of_fixed_order_is_that_of_python_control():
    structure = FixedOrder(1, 1, 1, 2, unit_rad_per_s=3000.0)
    numbers = np.array([0.3, *np.log([0.4, 5.0]), np.log(0.7), -0.2, np.log(2.0), np.log(0.3),
                        np.log(6.0), np.log(0.8)])
    s = control.tf("s") / 3000.0
    by_hand = (np.exp(0.3) / s * (1 + s / 0.4) / (1 + s / 5.0)
               * (s**2 / 0.49 - 0.4 / 0.7 * s + 1) / (s**2 / 4 + 0.3 * s + 1)
               / (s**2 / 36 + 1.6 / 6 * s + 1))
    points = 2j * np.pi * np.array([1.0, 300.0, 5000.0])
    np.testing.assert_allclose(structure.response(numbers, points)[0], by_hand(points), rtol=1e-9)
    discrete = structure.controller(numbers, PERIOD_S)
    on_circle = np.exp(points * PERIOD_S)
    tustin = 2 / PERIOD_S * (on_circle - 1) / (on_circle + 1)
    np.testing.assert_allclose(discrete(on_circle), by_hand(tustin), rtol=1e-9)
    assert discrete.nstates == 6


def test_the_best_straight_line_to_a_parabola_is_found():
    """Chebyshev: x^2 is approximated by x - 1/8 within 1/8 over 0 to 1."""
    x = np.linspace(0.0, 1.0, 101)

    def linearise(numbers):
        error = x**2 - numbers[0] - numbers[1] * x
        slopes = np.column_stack([-np.ones_like(x), -x])
        return Linearised(np.r_[error, -error], np.r_[slopes, -slopes],
                          np.array([-1.0]), np.zeros((1, 2)), True)

    numbers, there = lower_largest(linearise, np.array([3.0, -2.0]), np.full(2, -9.0),
                                   np.full(2, 9.0), 60)
    np.testing.assert_allclose(numbers, [-0.125, 1.0], atol=1e-3)
    assert there.cost == pytest.approx(0.125, abs=1e-3)


def test_a_bound_is_kept():
    """The least of |x - 3| where x may not exceed 2."""
    def linearise(numbers):
        x = numbers[0]
        return Linearised(np.array([x - 3, 3 - x]), np.array([[1.0], [-1.0]]),
                          np.array([x - 2.0]), np.array([[1.0]]), True)

    numbers, _ = lower_largest(linearise, np.zeros(1), np.full(1, -9.0), np.full(1, 9.0), 60)
    assert numbers[0] == pytest.approx(2.0, abs=1e-3)


def test_the_tuning_begins_with_less_gain_where_its_start_is_not_stable(model):
    soft = replace(model, dynamics=ElectricVibrationDynamics(0.002, (1500.0, 2600.0), (0.3, 0.03)))
    demands = Demands(errors=ModelErrors(0.02, 0.02), attenuation_db=(6.0, 3.0))
    controller = design_at_sample_rate(soft, demands, clock_period_s=PERIOD_S, effort=0.0)
    assert controller.report["figures"]["unstable"] == 0
    assert controller.delay_ticks == 0


def test_a_saved_design_is_loaded_with_its_method(model, tmp_path):
    demands = Demands(errors=ModelErrors(0.02, 0.02), attenuation_db=(10.0, 5.0))
    designed = design_at_sample_rate(model, demands, effort=0.0)
    save_controller(tmp_path / "controller.json", designed)
    loaded = load_stabilising_controller(tmp_path / "controller.json", model, PERIOD_S, PERIOD_S)
    assert loaded.report["method"] == "fixed_order_resonant"


def test_senseless_designs_are_refused(model):
    with pytest.raises(ValueError, match="no mode"):
        design_at_sample_rate(replace(model, dynamics=ElectricVibrationDynamics(0.001)))


def test_a_loop_that_amplifies_slow_errors_exceeds_a_bound(model):
    """An integral with a resonance at 15 Hz: the sensitivity peaks below half of 50 Hz."""
    demands = Demands()
    loops = demands.loops(model, PERIOD_S)
    s = control.tf("s")
    hz = 2 * np.pi * 15.0
    resonant = 100.0 / s * (s**2 + 2 * hz * s + hz**2) / (s**2 + 0.5 * hz * s + hz**2)
    controller = control.ss(resonant).sample(PERIOD_S, method="bilinear")
    figures = loops.measure(controller)
    highest_hz = loops.frequency_hz[loops.slow][-1]
    assert 20.0 < highest_hz <= 25.0
    points = np.exp(2j * np.pi * np.linspace(1.0, highest_hz, 500) * PERIOD_S)
    brute = max(np.abs(1 / (1 + (plant * controller)(points, squeeze=True))).max()
                for plant in loops.plants)
    assert figures.worst_slow_sensitivity == pytest.approx(brute, rel=0.05)
    assert figures.worst_slow_sensitivity > 1.05 and not figures.unstable
    expected_db = 20 * np.log10(figures.worst_slow_sensitivity)
    assert demands.violation_db(figures) - replace(
        demands, slow_sensitivity=100.0).violation_db(figures) == pytest.approx(expected_db)
