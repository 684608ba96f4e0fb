# SPDX-License-Identifier: BSD-3-Clause
"""Sums of plays against plays that are followed sample by sample, which share no code with them."""

from dataclasses import replace

import numpy as np
import pytest

from piezo_identification.estimators.hysteresis.equations import HysteresisSegment
from piezo_identification.estimators.hysteresis.everett_regression import everett_regression
from piezo_identification.estimators.hysteresis.play_fit import _PlayRegression, fit_plays
from piezo_identification.estimators.hysteresis.smoothed_density import (
    _output_um,
    density_of_segments,
)
from piezo_models.hysteresis.preisach import PreisachModel

LEVELS_V = np.linspace(0.0, 100.0, 201)
HALF_WIDTHS_V, WEIGHTS = np.array([0.0, 2.0, 5.0, 9.0]), np.array([0.08, 0.03, 0.02, 0.01])


def followed_um(voltage_v, bent):
    """Follow plays, one side of which is bent, on a stage that was swept from 0 to 100 V before."""
    voltage_v = np.concatenate([[100.0, 0.0], voltage_v])
    rising_v, falling_v = voltage_v, (1.0 + bent) * voltage_v - bent * voltage_v**2 / 100.0
    states, output = np.zeros(4), []
    for up_v, down_v in zip(rising_v, falling_v, strict=True):
        states = np.maximum(up_v - HALF_WIDTHS_V, np.minimum(down_v + HALF_WIDTHS_V, states))
        output.append(WEIGHTS @ states)
    return np.array(output)[2:]


def loops_v(turns_v, rows=4000):
    ways = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(turns_v)))])
    return np.interp(np.linspace(0.0, ways[-1], rows), ways, turns_v)


def segment(voltage_v, output_um):
    return HysteresisSegment(voltage_v, output_um, np.arange(voltage_v.size),
                             np.empty((voltage_v.size, 0)))


@pytest.mark.parametrize("bent", [0.0, 0.05])
def test_plays_are_found_and_predict_loops_that_they_were_not_fitted_to(bent):
    fitted_v = loops_v([0.0, 100.0, *np.ravel([(5.0 * k, 100.0) for k in range(1, 19)]), 0.0])
    noise_um = 1e-3 * np.random.default_rng(0).standard_normal(fitted_v.size)
    plays = fit_plays([segment(fitted_v, followed_um(fitted_v, bent) + noise_um)], LEVELS_V)
    assert plays.noise_um == pytest.approx(1e-3, rel=0.1)
    assert bool(np.any(np.append(plays.rising, plays.falling))) == bool(bent)
    unseen_v = loops_v([0.0, 100.0, 30.0, 62.0, 41.0, 55.0, 44.0, 90.0, 10.0])
    truth_um = followed_um(unseen_v, bent)
    predicted_um = everett_regression(unseen_v, LEVELS_V).matrix @ plays.unknowns(200)
    error_um = (predicted_um - truth_um)[unseen_v.size // 4 :]
    # Plays turn within a cell of 0.5 V.
    assert np.std(error_um) < 4e-3 * np.std(truth_um)


def test_derivatives_are_those_of_the_squares_of_the_best_plays():
    voltage_v = loops_v([0.0, 100.0, *np.ravel([(9.0 * k, 100.0) for k in range(1, 11)]), 0.0])
    regression = _PlayRegression([segment(voltage_v, followed_um(voltage_v, 0.2))], LEVELS_V)
    curves, step = np.array([0.05, -0.03, 0.1, 0.04, -0.02]), 1e-5

    def squares(moved):
        return 0.5 * np.sum(regression.residual_um(moved) ** 2)
    slopes = [(squares(curves + step * each) - squares(curves - step * each)) / (2.0 * step)
              for each in np.eye(5)]
    residual_um = regression.residual_um(curves)
    found = regression.derivatives_um(curves).T @ residual_um
    assert found == pytest.approx(np.array(slopes), rel=0.02, abs=0.02 * np.abs(slopes).max())


def test_too_few_samples_are_not_fitted():
    voltage_v = loops_v([0.0, 100.0, 20.0, 80.0], rows=200)
    assert fit_plays([segment(voltage_v, followed_um(voltage_v, 0.0))], LEVELS_V) is None


def test_the_unknowns_of_all_grids_are_those_of_one_hysteresis():
    """The Everett value of the whole range does not depend on the cells."""
    voltage_v = loops_v([0.0, 100.0, 0.0, 100.0, 40.0, 100.0, 60.0, 90.0, 0.0])
    plays = fit_plays([segment(voltage_v, followed_um(voltage_v, 0.05))], LEVELS_V)
    whole_um = [plays.unknowns(size)[size * (size - 1) // 2] for size in (20, 50, 200)]
    assert whole_um == pytest.approx([whole_um[0]] * 3, rel=1e-12)


def test_a_density_about_plays_keeps_what_narrow_plays_add_to_whole_cells():
    """Both sides follow a cubic curve, which the plays do not; the density adds the rest."""
    half_widths_v = 2.0 * np.arange(8)
    weights = np.append(0.07, np.full(7, 0.004))
    turns_v = np.ravel([(5.0 * level, 0.0) for level in range(1, 21)])
    voltage_v = np.concatenate([[0.0, 100.0, 0.0], loops_v([0.0, *turns_v], 1000)])
    curve = voltage_v + 0.3 * (voltage_v - 50.0) ** 3 / 50.0**2
    states, output_um = np.zeros(8), []
    for value in curve:
        states = np.maximum(value - half_widths_v, np.minimum(value + half_widths_v, states))
        output_um.append(weights @ states)
    loops, truth_um = slice(3, None), np.array(output_um)
    noise_um = 4e-5 * np.ptp(truth_um) * np.random.default_rng(0).standard_normal(1000)
    density = density_of_segments(
        [segment(voltage_v[loops], truth_um[loops] + noise_um)], np.linspace(0.0, 100.0, 31))
    assert density.plays is not None and len(density.visited) > 30
    error_um = (density.model().simulate(voltage_v) - truth_um)[loops]
    assert np.std(error_um) < np.std(noise_um)


@pytest.mark.parametrize("bent", [0.05, None], ids=["plays", "no plays"])
def test_the_kind_of_an_earlier_estimate_does_not_change_the_loops(bent):
    voltage_v = loops_v([0.0, 100.0, *np.ravel([(5.0 * k, 100.0) for k in range(1, 19)]), 0.0])
    if bent is None:
        middle, half = np.add.outer(np.arange(40), np.arange(40)), np.tri(40)
        output_um = PreisachModel(
            0.0, 100.0, 1e-3 * half * (1.0 + np.sin(0.1 * middle) ** 2)).simulate(voltage_v)
    else:
        output_um = followed_um(voltage_v, bent)
    noise_um = 1e-3 * np.random.default_rng(0).standard_normal(voltage_v.size)
    found_um = [density_of_segments(
        [segment(voltage_v, output_um + noise_um)], LEVELS_V[::4], is_of_plays=is_of_plays,
    ).model().simulate(voltage_v) for is_of_plays in (False, True)]
    assert np.std(found_um[1] - output_um) < 1.1 * np.std(found_um[0] - output_um)


@pytest.mark.long
def test_small_loops_are_followed_where_most_of_the_gain_turns_within_a_volt():
    """The cells are then so narrow that they err by a part of the noise."""
    fitted_v = loops_v([0.0, 100.0, *np.ravel([(5.0 * k, 100.0) for k in range(1, 19)]), 0.0], 6000)
    noise_um = 1e-2 * np.random.default_rng(0).standard_normal(fitted_v.size)
    density = density_of_segments(
        [segment(fitted_v, followed_um(fitted_v, 0.02) + noise_um)], np.linspace(0.0, 100.0, 141))
    turns_v = 50.0 + np.random.default_rng(3).uniform(-8.0, 8.0, 60)
    unseen_v = loops_v([100.0, 0.0, 100.0, 20.0, *turns_v], 8000)
    error_um = density.model().simulate(unseen_v) - followed_um(unseen_v, 0.02)
    assert np.std(error_um[4000:]) < 0.2 * np.std(noise_um)


def test_a_recording_counts_as_much_as_its_weight():
    voltage_v = loops_v([0.0, 100.0, *np.ravel([(5.0 * k, 100.0) for k in range(1, 19)]), 0.0])
    right = segment(voltage_v, followed_um(voltage_v, 0.05))
    wrong = replace(segment(voltage_v, 1.3 * followed_um(voltage_v, 0.0)), weight=1e-12)
    alone, beside = (fit_plays(each, LEVELS_V) for each in ([right], [right, wrong]))
    assert beside.unknowns(40) == pytest.approx(alone.unknowns(40), abs=1e-3)


def test_the_output_of_plays_at_some_samples_is_that_at_all_of_them():
    voltage_v = loops_v([0.0, 100.0, 30.0, 62.0, 41.0, 90.0, 10.0])
    whole = segment(voltage_v, followed_um(voltage_v, 0.0))
    few = replace(whole, samples=whole.samples[5::7])
    plays = fit_plays([whole], LEVELS_V)
    at_few, at_all = (_output_um(each, LEVELS_V, plays, 2) for each in (few, whole))
    np.testing.assert_allclose(at_few[few.samples], at_all[few.samples])
    assert not np.delete(at_few, few.samples).any()
