# SPDX-License-Identifier: BSD-3-Clause
"""The nonlinear spring beside a root finder and an integrator of differential equations."""

from functools import cache, partial

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from piezo_models.effects.spring_equation import (
    FARTHEST,
    SOFTEST,
    force_and_slope,
    straight_beyond,
)
from piezo_models.effects.stiffening import Stiffening

CENTRE_UM, HALF_RANGE_UM = 2.0, 10.0
SPRINGS = {
    "hard": (0.5, 1.0, 20.0, 0.0),
    "bent": (0.5, 3.0, 20.0, -3.0),
    "soft": (-1.0, 0.0, -2.5, 0.0),
}


def spring(parts, frequency_rad_per_s=0.0, damping_ratio=1.0, viscous=0.0):
    linear, square, cubic, quartic = parts
    return Stiffening(linear, square, cubic, CENTRE_UM, HALF_RANGE_UM, frequency_rad_per_s,
                      damping_ratio, quartic_um=quartic, viscous=viscous)


# The root finder and the integrator ask for the force many thousand times.
ends_of = cache(straight_beyond)


def force(parts, y):
    low, high = ends_of(parts, HALF_RANGE_UM)
    return force_and_slope((y - CENTRE_UM) / HALF_RANGE_UM, np.array(parts), low, high)[0]


@pytest.mark.parametrize("parts", SPRINGS.values(), ids=SPRINGS)
def test_at_rest_the_displacement_is_the_root_of_the_springs_equation(parts):
    load_um = np.linspace(-80.0, 80.0, 101)
    found = spring(parts).apply(load_um, 1e-3)
    roots = [brentq(lambda y, x=x: y + force(parts, y) - x, -1e4, 1e4, xtol=1e-13, rtol=1e-15)
             for x in load_um]
    np.testing.assert_allclose(found, roots, rtol=0.0, atol=1e-12 * np.abs(load_um).max())
    assert (np.diff(found) > 0.0).all()


def test_the_force_is_the_polynomial_within_the_range_and_goes_on_straight():
    parts = SPRINGS["soft"]
    low, high = straight_beyond(parts, HALF_RANGE_UM)
    assert -FARTHEST < low < -1.0 and 1.0 < high < FARTHEST
    x = 0.9 * high
    assert force(parts, CENTRE_UM + HALF_RANGE_UM * x) == pytest.approx(
        parts[0] * x + parts[2] * x**3)
    ends = [force(parts, CENTRE_UM + HALF_RANGE_UM * (high + step)) for step in (0.0, 1.0, 2.0)]
    assert np.diff(ends) == pytest.approx([(SOFTEST - 1.0) * HALF_RANGE_UM] * 2)


def errors_in_motion(parts, drive, w, time_s, viscous):
    """Return the errors in motion, the motion, and that of the linear spring, over the last two."""
    damping_ratio = 0.05

    def motion(t, state, of_spring, damped):
        y, speed = state
        return speed, w * w * (drive(t) - y - of_spring(y)) - damped * w * speed

    def solved(of_spring, begin_um, damped=2.0 * damping_ratio):
        return solve_ivp(motion, (0.0, time_s[-1]), (begin_um, 0.0), "DOP853", time_s, rtol=1e-8,
                         atol=1e-8, args=(of_spring, damped)).y[0]

    rest_um = brentq(lambda y: y + force(parts, y), -100.0, 100.0)
    linear_um = solved(lambda y: 0.0, 0.0)
    expected_um = solved(partial(force, parts), rest_um, 2.0 * damping_ratio + viscous)
    found_um = spring(parts, w, damping_ratio, viscous).apply(linear_um, time_s[1], 0.0)
    return found_um - expected_um, expected_um, linear_um


@pytest.mark.parametrize("viscous", [
    0.2, *(pytest.param(viscous, marks=pytest.mark.long) for viscous in (0.0, -0.06))])
@pytest.mark.parametrize(("phase", "samples", "tolerance"), [
    (0.72, 150, 5e-3), (0.05, 1000, 1e-4)])
def test_in_motion_it_is_the_solution_of_the_equation_of_motion(
        phase, samples, tolerance, viscous):
    """A force three times that of the linear spring, on coarse samples and on fine ones."""
    w = 440.0
    errors_um, expected_um, linear_um = errors_in_motion(
        SPRINGS["hard"],
        lambda t: 15.0 * np.sin(0.15 * w * t) + 12.0 * np.sin(0.61 * w * t), w,
        np.arange(samples) * phase / w, viscous)
    assert np.std(linear_um - expected_um) > np.std(expected_um)
    assert np.std(errors_um) < tolerance * np.std(expected_um)


def test_noise_up_to_a_third_of_the_sample_rate_is_followed_between_the_samples():
    """A mode at a ninth of it."""
    random, w, period_s = np.random.default_rng(3), 440.0, 2.0 * np.pi / 9.0 / 440.0
    rates = 2.0 * np.pi / period_s * np.linspace(0.01, 1.0 / 3.0, 25)
    phases = random.uniform(0.0, 2.0 * np.pi, rates.size)
    begun = 20.0 * period_s
    errors_um, expected_um, linear_um = errors_in_motion(
        (0.0, 0.0, 2.0, 0.0),
        lambda t: 0.8 * np.tanh(t / begun) ** 4 * np.sum(np.sin(rates * t + phases)),
        w, np.arange(150) * period_s, 0.1)
    assert np.std(linear_um - expected_um) > 0.1 * np.std(expected_um)
    assert np.std(errors_um) < 5e-3 * np.std(expected_um)


def test_a_spring_that_gives_way_within_the_range_is_impossible():
    assert spring(SPRINGS["hard"]).impossible(None) is None
    assert spring(SPRINGS["soft"]).impossible(None) is None
    assert "softer" in spring((0.0, 0.0, -4.0, 0.0)).impossible(None)
    assert "softer" in spring((-9.5, 0.0, 0.0, 0.0)).impossible(None)
    assert "gain energy" in spring(SPRINGS["hard"], 440.0, 0.05, -0.11).impossible(None)


def test_a_mode_far_faster_than_the_samples_is_at_its_rest_at_each_of_them():
    # The period of the mode is 0.6 of a sample, as in minutes of creep.
    slow_um = 5.0 * np.sin(np.linspace(0.0, 20.0, 2000))
    parts = SPRINGS["hard"]
    np.testing.assert_array_equal(
        spring(parts, 1000.0, 0.02).apply(slow_um, 2.1e-2), spring(parts).apply(slow_um, 2.1e-2))
    assert np.any(spring(parts, 1000.0, 0.02).apply(slow_um, 1.9e-2)
                  != spring(parts).apply(slow_um, 1.9e-2))
