# SPDX-License-Identifier: BSD-3-Clause
"""The hysteresis of Bouc and Wen against its differential equation, and its laws."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from piezo_models.effects.bouc_wen_hysteresis import BoucWenHysteresis
from piezo_models.effects.curved_bouc_wen_hysteresis import CurvedBoucWenHysteresis
from piezo_models.effects.effect import Extent

PERIOD_S = 1e-3
EXTENT = Extent(10.0, -20.0, 20.0, 1.0, PERIOD_S)


def turns(seed=0, count=8):
    levels_v = 10.0 * np.random.default_rng(seed).uniform(-1.0, 1.0, count)
    return np.concatenate([[0.0], levels_v])


@pytest.mark.parametrize(("unloading", "exponent", "within_v"), [
    (0.0, 1.0, 2e-5), (0.4, 1.0, 2e-5), (1.0, 1.0, 1e-7), (3.0, 1.0, 2e-5),
    (0.4, 2.0, 1e-6), (1.0, 1.6, 3e-6), (3.0, 0.7, 1e-4)])
def test_it_is_the_solution_of_the_equation_of_bouc_and_wen(unloading, exponent, within_v):
    # A step of the solution in which the branch changes has an error of 1e-5 of the saturation.
    effect = BoucWenHysteresis(1.5, 8.0, unloading, exponent)
    slope = effect.saturation_v / effect.relaxation_v
    rate = slope / effect.saturation_v**exponent
    beta, gamma = 0.5 * rate * (1.0 + unloading), 0.5 * rate * (1.0 - unloading)
    levels_v, taken_v = turns(), [0.0]
    for before_v, after_v in zip(levels_v[:-1], levels_v[1:], strict=True):
        sign = np.sign(after_v - before_v)
        taken_v.append(solve_ivp(
            lambda _, z, sign=sign: slope * sign - beta * np.sign(z) * np.abs(z) ** exponent
            - gamma * sign * np.abs(z) ** exponent,
            (0.0, abs(after_v - before_v)), taken_v[-1:], rtol=1e-10, atol=1e-12).y[0, -1])
    assert levels_v - effect.apply(levels_v, PERIOD_S) == pytest.approx(taken_v, abs=within_v)


@pytest.mark.parametrize("exponent", [1.0, 1.7])
def test_samples_on_the_way_do_not_matter(exponent):
    effect, levels_v = BoucWenHysteresis(1.0, 4.0, 0.5, exponent), turns(1)
    fine_v = np.concatenate([np.linspace(*ends, 50) for ends in zip(
        levels_v[:-1], levels_v[1:], strict=True)])
    assert effect.apply(fine_v, PERIOD_S)[49::50] == pytest.approx(
        effect.apply(levels_v, PERIOD_S)[1:], rel=1e-9, abs=1e-7 * (exponent != 1.0))


@pytest.mark.parametrize("exponent", [1.0, 1.7])
def test_a_held_voltage_changes_nothing_and_far_away_it_saturates(exponent):
    effect = BoucWenHysteresis(1.0, 4.0, 0.5, exponent)
    behind_v = effect.apply(np.array([0.0, 200.0, 200.0, -200.0, -200.0]), PERIOD_S)
    assert behind_v == pytest.approx([0.0, 199.0, 199.0, -199.0, -199.0])


def test_the_signal_behind_rises_with_the_voltage_unless_it_is_called_impossible():
    rising_v, falling_v = np.linspace(-20.0, 20.0, 400), np.linspace(20.0, -20.0, 400)
    wave_v = np.concatenate([rising_v, falling_v, rising_v])
    for relaxation_v, is_possible in ((2.2, True), (1.8, False)):
        effect = BoucWenHysteresis(1.0, relaxation_v, 1.0)
        moves_v = np.diff(effect.apply(wave_v, PERIOD_S))
        assert (effect.impossible(EXTENT) is None) == is_possible
        assert np.all(moves_v * np.diff(wave_v) >= 0.0) == is_possible


@pytest.mark.parametrize("exponent", [1.0, 1.3])
def test_a_curve_beside_it_adds_to_the_voltage_and_leaves_the_hysteresis_as_it_is(exponent):
    voltage_v, curvature_per_v = turns(3, 40), 4e-3
    plain, curved = BoucWenHysteresis(1.0, 4.0, 0.5, exponent), CurvedBoucWenHysteresis(
        1.0, 4.0, 0.5, exponent, curvature_per_v)
    added_v = curved.apply(voltage_v, PERIOD_S) - plain.apply(voltage_v, PERIOD_S)
    assert added_v == pytest.approx(curvature_per_v * voltage_v**2, abs=1e-12)
    np.testing.assert_array_equal(curved.memory_after(voltage_v), plain.memory_after(voltage_v))


@pytest.mark.parametrize(("unloading", "exponent", "within_v"), [
    (0.0, 1.0, 2e-5), (1.0, 1.0, 2e-6), (0.4, 2.0, 1e-6), (3.0, 0.7, 1e-4)])
def test_it_grows_and_decays_by_other_amounts_at_each_voltage(unloading, exponent, within_v):
    effect = CurvedBoucWenHysteresis(
        1.5, 8.0, unloading, exponent, growth_slope_per_v=0.03, growth_curvature_per_v2=-0.004,
        decay_slope_per_v=0.02, middle_v=1.0)

    def change(way_v, part, before_v, sign):
        off_v = before_v + sign * way_v - 1.0
        growth = 1.0 + 0.03 * off_v - 0.004 * off_v**2
        size, tilt = np.abs(part) ** exponent, 0.02 * sign * off_v
        return sign * (growth - np.where(
            sign * part < 0.0, tilt - unloading, 1.0 + tilt) * size) / 8.0

    levels_v, parts = turns(), [0.0]
    for before_v, after_v in pairwise(levels_v):
        parts.append(solve_ivp(change, (0.0, abs(after_v - before_v)), parts[-1:], rtol=1e-10,
                               atol=1e-12, args=(before_v, np.sign(after_v - before_v))).y[0, -1])
    assert levels_v - effect.apply(levels_v, PERIOD_S) == pytest.approx(
        1.5 * np.array(parts), abs=within_v)


@given(st.floats(0.0, 5.0), st.floats(0.5, 5.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0),
       st.floats(-0.5, 0.5))
def test_what_is_taken_is_bounded_with_all_parameters_of_a_fit(
        unloading, exponent, slope, curve, tilt):
    half_v = 0.5 * EXTENT.span_v
    effect = CurvedBoucWenHysteresis(1.0, 1.0, unloading, exponent,
                                     growth_slope_per_v=slope / half_v,
                                     growth_curvature_per_v2=curve / half_v**2,
                                     decay_slope_per_v=tilt / half_v)
    voltage_v = 2.0 * turns(4, 60)
    taken_v = voltage_v - effect.apply(voltage_v, PERIOD_S)
    assert np.abs(taken_v).max() <= 1.01 * 6.0 ** (1.0 / exponent)


@pytest.mark.parametrize("curvature_per_v, is_possible", [(0.01, True), (0.02, False)])
def test_a_curve_beside_it_that_would_move_the_stage_back_is_impossible(
        curvature_per_v, is_possible):
    # At -20 V, the slope of the curve is 1 - 40 c, and the hysteresis takes 0.5 of it.
    effect = CurvedBoucWenHysteresis(1.0, 4.0, 1.0, curvature_per_v=curvature_per_v)
    assert (effect.impossible(EXTENT) is None) == is_possible
