# SPDX-License-Identifier: BSD-3-Clause
"""Dynamics of a stage that shares no code with the model, with what nobody told of."""

import sys
from functools import reduce
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))
from independent_stage import IndependentStage, square_wave_v

from piezo_identification.adequacy.component_adequacy import INADEQUATE, adequacy_of
from piezo_identification.estimators.dynamics.fast_dynamics import ModeOrder
from piezo_identification.estimators.dynamics.fast_estimate import estimate_dynamics, mean_period
from piezo_identification.estimators.dynamics.output_error import fit_output_error
from piezo_identification.identification.linear_dynamics import LinearDynamics
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics

PERIOD_S = 25e-6
NOISE_UM = 0.009
PERIODS = 30
FOLDED_NOISE_UM = NOISE_UM / np.sqrt(PERIODS - 15)
MODES = ((2846.0, 0.685, 0.7), (4909.0, 0.082, 0.3))


def record(stage, seed=1, noise_um=NOISE_UM):
    return stage.record(square_wave_v(periods=PERIODS), PERIOD_S, noise_um, seed)


def estimated(stage, seed=1):
    return estimate_dynamics(record(stage, seed), CreepDynamics())


def drawn_stage(seed, with_stiffening=False):
    """A lag and two or three modes of either sign, and one thing that nobody told of."""
    draw = np.random.default_rng(seed)
    second = draw.uniform(0.1, 0.4) * draw.choice([1.0, 1.0, -0.5])
    third = draw.uniform(0.03, 0.1) * draw.choice([0.0, 1.0, 1.0, -1.0])
    first_rad_per_s = draw.uniform(2000.0, 4000.0)
    modes = [
        (first_rad_per_s, draw.uniform(0.05, 0.7), 1.0 - second - third),
        (first_rad_per_s * draw.uniform(1.5, 2.5), draw.uniform(0.02, 0.1), second)]
    if third:
        modes.append((2.0 * np.pi * draw.uniform(1100.0, 1900.0), draw.uniform(0.005, 0.02), third))
    hidden = (
        {}, {"delay_s": draw.uniform(0.2, 8.0) * PERIOD_S}, {"read_at": 1.0},
        {"sensor_lag_s": draw.uniform(0.5, 5.0) * PERIOD_S}, {"read_at": draw.uniform(0.2, 1.5)},
        {"stiffening_per_um2": np.exp(draw.uniform(np.log(1e-6), np.log(2e-5)))},
    )[draw.integers(6 if with_stiffening else 5)]
    lag_s = np.exp(draw.uniform(np.log(1e-4), np.log(8e-4)))
    return IndependentStage(float(lag_s), tuple(modes), **hidden)


def normalised_errors(stage, estimate):
    """Errors over their standard deviations: of all numbers, infinite where one is missing."""
    found, spread = estimate.model, estimate.standard_deviations
    modes = list(zip(found.mode_frequencies_rad_per_s, found.damping_ratios,
                     spread["mode_frequencies_rad_per_s"], spread["damping_ratios"], strict=True))
    lags = []
    for effect, deviation in zip(estimate.effects, estimate.effect_deviations, strict=True):
        if effect.name == "vibration_mode":
            modes.append((effect.frequency_rad_per_s, effect.damping_ratio,
                          deviation["frequency_rad_per_s"], deviation["damping_ratio"]))
        else:
            lags.append((effect.time_constant_s, deviation["time_constant_s"]))
    if len(modes) != len(stage.modes) or len(lags) != bool(stage.sensor_lag_s):
        return np.array([np.inf])
    errors = [(found.time_constant_s - stage.lag_s) / spread["time_constant_s"],
              (estimate.delay.samples - stage.delay_s / PERIOD_S + stage.read_at)
              / (estimate.delay.standard_deviation_s / PERIOD_S)]
    errors += [(lag_s - stage.sensor_lag_s) / deviation for lag_s, deviation in lags]
    for (frequency, damping, of_frequency, of_damping), truth in zip(
            sorted(modes), sorted(stage.modes), strict=True):
        errors += [(frequency - truth[0]) / of_frequency, (damping - truth[1]) / of_damping]
    return np.array(errors)


@pytest.mark.parametrize(("hidden", "samples"), [
    pytest.param({"delay_s": 1e-4}, 4.0, id="delay", marks=pytest.mark.long),
    pytest.param({"read_at": 1.0}, -1.0, id="end of hold", marks=pytest.mark.long),
    pytest.param({"read_at": 0.4}, -0.4, id="within the hold", marks=pytest.mark.long),
    pytest.param({"sensor_lag_s": 1e-4}, 0.0, id="sensor lag", marks=pytest.mark.long)])
def test_what_hides_behind_the_dynamics_is_found_and_does_not_bend_them(hidden, samples):
    stage = IndependentStage(4.9e-4, MODES, **hidden)
    estimate = estimated(stage)
    assert estimate.residual_rms < 1.2 * FOLDED_NOISE_UM
    assert estimate.delay.samples == pytest.approx(samples, abs=0.02)
    assert estimate.delay.is_significant == bool(samples)
    assert np.abs(normalised_errors(stage, estimate)).max() < 4.0


@pytest.mark.long
@pytest.mark.parametrize("hertz", [1100.0, 1900.0])
def test_a_third_mode_that_rings_long_is_found_and_does_not_bend_the_others(hertz):
    stage = IndependentStage(
        4.9e-4, ((2846.0, 0.3, 0.65), (4909.0, 0.082, 0.3), (2.0 * np.pi * hertz, 0.01, 0.05)))
    estimate = estimated(stage)
    assert estimate.residual_rms < 1.2 * FOLDED_NOISE_UM
    assert np.abs(normalised_errors(stage, estimate)).max() < 4.0


def test_a_mode_that_may_not_be_fitted_is_not_taken_for_a_delay():
    stage = IndependentStage(4.9e-4, (
        (2846.0, 0.685, 0.696), (4909.0, 0.082, 0.3), (8796.0, 0.01, 0.004)))
    estimate = estimate_dynamics(record(stage), CreepDynamics(), mode_count=2)
    assert estimate.residual_rms > 2.0 * FOLDED_NOISE_UM
    assert not estimate.delay.is_significant


def zeros_of(modes):
    """Zeros of modes that add up: what each adds, over the common denominator."""
    def quadratic(mode):
        return [1.0, 2.0 * mode[1] * mode[0], mode[0] ** 2]

    numerator = np.zeros(1)
    for index, mode in enumerate(modes):
        others = [quadratic(each) for place, each in enumerate(modes) if place != index]
        numerator = np.polyadd(
            numerator, mode[2] * mode[0] ** 2 * reduce(np.polymul, others, np.ones(1)))
    return np.roots(numerator)


def drawn_modes_of_either_sign(seed):
    """Two or three modes with zeros on the right, the first drawn ones that have them."""
    draw = np.random.default_rng(seed)
    while True:
        parts = draw.uniform(0.04, 0.3, draw.choice([1, 2])) * draw.choice([-1.0, -1.0, 1.0])
        rates = draw.uniform(2000.0, 4000.0) * np.cumprod(
            [1.0, *draw.uniform(1.3, 2.2, parts.size)])
        dampings = [draw.uniform(0.02, 0.6), *draw.uniform(0.01, 0.06, parts.size)]
        modes = tuple(zip(rates.tolist(), dampings, [1.0 - parts.sum(), *parts.tolist()],
                          strict=True))
        if zeros_of(modes).real.max() > 0.0:
            return modes


@pytest.mark.long
@pytest.mark.parametrize("modes", [
    ((2500.0, 0.45, 1.17), (4760.0, 0.045, -0.17)),
    ((3200.0, 0.5, 0.85), (5400.0, 0.025, 0.19), (8300.0, 0.015, -0.04)),
    *map(drawn_modes_of_either_sign, range(3))])
def test_modes_of_opposite_sign_are_found_beside_each_other(modes):
    """Their zeros lie on the right, where no antiresonance can stand for them."""
    assert zeros_of(modes).real.max() > 0.0
    stage = IndependentStage(3e-4, modes)
    estimate = estimated(stage)
    assert [effect.name for effect in estimate.effects] == ["vibration_mode"] * (len(modes) - 1)
    assert estimate.residual_rms < 1.2 * FOLDED_NOISE_UM
    assert np.abs(normalised_errors(stage, estimate)).max() < 4.0


@pytest.mark.long
@pytest.mark.parametrize("seed", [
    14, 69,  # dynamics with fewer modes than these stages have all lack a standing
    88, 99])  # the lowest mode is damped beyond what one beside others may be
def test_the_search_does_not_end_before_three_modes_nor_begin_where_none_may_stand(seed):
    stage = drawn_stage(seed, with_stiffening=True)
    estimate = estimated(stage, seed)
    assert estimate.residual_rms < 1.2 * FOLDED_NOISE_UM
    assert np.abs(normalised_errors(stage, estimate)).max() < 4.0


@pytest.mark.long
@pytest.mark.parametrize("seed", range(100))
def test_no_form_leaves_less_than_coupled_modes_with_its_poles(seed):
    estimate = estimated(drawn_stage(seed), seed)
    trials = {trial.order: trial.residual_rms for trial in estimate.trials}
    coupled = {order.parallel: left for order, left in trials.items() if order.is_coupled}
    forms = [(order.modes + order.parallel, left) for order, left in trials.items()
             if not order.is_coupled and not order.sensor_lags]
    assert any(modes in coupled for modes, _ in forms)
    assert all(left > 0.999 * coupled[modes] for modes, left in forms if modes in coupled)


def adequacy(recording, estimate):
    """Verdict on the dynamics, their delay told apart as in a model."""
    found = LinearDynamics().with_dynamics(estimate)
    line = PreisachModel(20.0, 80.0, np.zeros((1, 1)), 0.0, np.array([1.0]))
    model = StageModel(line, CreepDynamics(), found.dynamics, effects=found.all_effects)
    return adequacy_of(model, {"dynamics": recording}, {
        "dynamics": -found.read_at_samples * PERIOD_S})["dynamics"]


def is_right_or_inadequate(seed):
    """Whether no number is off by more than chance makes the largest of nine, or it is said.

    The largest of eight or nine numbers: three deviations of each are 3.5 of the largest.
    """
    stage = drawn_stage(seed, with_stiffening=True)
    recording = record(stage, seed)
    estimate = estimate_dynamics(recording, CreepDynamics())
    return (not stage.stiffening_per_um2 and np.abs(normalised_errors(stage, estimate)).max() < 3.5
            or adequacy(recording, estimate).verdict == INADEQUATE)


@pytest.mark.long
def test_numbers_are_within_three_deviations_or_the_dynamics_are_called_inadequate():
    right = np.array([is_right_or_inadequate(seed) for seed in range(100)])
    assert right.mean() >= 0.95, np.flatnonzero(~right)


@pytest.mark.long
def test_eight_modes_of_a_structure_are_found():
    frequencies = 2.0 * np.pi * np.array([300.0, 520, 800, 1150, 1600, 2200, 2900, 3700])
    parts = np.array([0.4, 0.2, 0.1, 0.1, 0.06, 0.06, 0.05, 0.03])
    stage = IndependentStage(1e-4, tuple((w, 0.02, part) for w, part in zip(
        frequencies.tolist(), parts.tolist(), strict=True)))
    estimate = estimated(stage)
    assert estimate.order.modes + estimate.order.parallel == 8
    assert estimate.residual_rms < 1.2 * FOLDED_NOISE_UM


@pytest.mark.long
def test_a_spring_that_stiffens_makes_no_further_mode():
    stage = IndependentStage(4.9e-4, MODES, stiffening_per_um2=1e-5)
    estimate = estimated(stage)
    assert estimate.order.modes + estimate.order.parallel == 2
    # What is left is a hundred times the noise: the test of adequacy has to say so.
    assert estimate.residual_rms > 30.0 * FOLDED_NOISE_UM


def test_a_known_delay_is_not_fitted():
    stage = IndependentStage(4.9e-4, MODES, delay_s=2.0 * PERIOD_S)
    estimate = fit_output_error(mean_period(record(stage), CreepDynamics()), 2, delay=2.0)
    assert estimate.delay is None
    assert str(estimate.order) == "2"


def test_only_orders_that_are_asked_for_are_tried_as_far_as_there_is_evidence_for_them():
    stage, period_s = IndependentStage(4.9e-4, ((2846.0, 0.2, 1.0),)), 4.0 * PERIOD_S
    voltage_v = square_wave_v(sample_period_s=period_s, periods=PERIODS)
    period = mean_period(stage.record(voltage_v, period_s, NOISE_UM, 1), CreepDynamics())
    every = fit_output_error(period)
    among = fit_output_error(period, among=[every.order])
    assert {trial.order for trial in among.trials} == {every.order}
    assert among.model == every.model and among.effects == every.effects
    useless = fit_output_error(period, among=[ModeOrder(7, 6)])
    assert {trial.order for trial in useless.trials} <= {trial.order for trial in every.trials}
    assert useless.order == every.order
