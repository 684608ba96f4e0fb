# SPDX-License-Identifier: BSD-3-Clause
"""The spring of Bouc and Wen beside an integrator of differential equations."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lsim, lti

from piezo_models.effects import Evidence, Extent
from piezo_models.effects.bouc_wen_equation import STIFFEST
from piezo_models.effects.hysteretic_spring import HystereticSpring
from piezo_models.linear.dynamics import ElectricVibrationDynamics

W, DAMPING, PERIOD_S = 250.0, 0.05, 1e-3
HALF_RANGE_UM = 4.0
SHAPES = {"closing": (-0.4, 0.02, 0.5, 0.6, 0.2, 1.0), "opening": (-0.5, 0.0, 0.4, 1.0, -1.4, 1.0),
          "sharp": (-0.2, 0.0, 0.3, 0.4, 0.1, 2.0)}


def drive_um(time_s, sin=np.sin):
    return 2.0 * sin(90.0 * time_s) + 1.5 * sin(0.83 * W * time_s + 1.0)


def solved(time_s, linear, viscous, stiffness, beta, gamma, exponent):
    """Return the displacement of the mass by an integrator that knows nothing of samples."""
    def motion(t, state):
        y, speed, z = state
        part = abs(z) / HALF_RANGE_UM
        whole = (1.0 + linear) * y + (2.0 * DAMPING + viscous) * speed / W + z
        return (speed, W * W * (drive_um(t, math.sin) - whole),
                stiffness * speed - beta * abs(speed) * part**exponent * math.copysign(1.0, z)
                - gamma * speed * part**exponent)

    return solve_ivp(motion, (0.0, time_s[-1]), (0.0, 0.0, 0.0), "LSODA", time_s, rtol=1e-7,
                     atol=1e-9, max_step=PERIOD_S).y[0]


def unloaded(time_s):
    """Return what the linear spring alone would do."""
    fine_s = np.linspace(0.0, time_s[-1], 20 * (time_s.size - 1) + 1)
    mode = lti([W * W], [1.0, 2.0 * DAMPING * W, W * W])
    return lsim(mode, drive_um(fine_s), fine_s)[1][::20]


@pytest.mark.parametrize("name", [
    pytest.param("closing", marks=pytest.mark.long), "opening", "sharp"])
def test_it_is_the_solution_of_the_equation_of_motion(name):
    time_s = np.arange(600) * PERIOD_S
    spring = HystereticSpring(*SHAPES[name], 0.0, HALF_RANGE_UM, W, DAMPING)
    linear_um, expected_um = unloaded(time_s), solved(time_s, *SHAPES[name])
    found_um = spring.apply(linear_um, PERIOD_S, 0.0)
    assert np.std(linear_um - expected_um) > 0.1 * np.std(expected_um)
    assert np.std(found_um - expected_um) < 2e-3 * np.std(expected_um)


def test_in_parts_it_goes_on_where_it_stopped():
    load_um = drive_um(np.arange(500) * PERIOD_S)
    spring = HystereticSpring(*SHAPES["closing"], 0.5, HALF_RANGE_UM, W, DAMPING)
    first, past = spring.advance(load_um[:123], PERIOD_S)
    kept = past.copy()
    again = [spring.advance(load_um[123:], PERIOD_S, past)[0] for _ in range(2)]
    np.testing.assert_array_equal(past, kept)
    for second in again:
        np.testing.assert_array_equal(np.concatenate([first, second]),
                                      spring.apply(load_um, PERIOD_S))


def test_however_large_the_load_it_stays_finite():
    opening = HystereticSpring(*SHAPES["opening"], 0.0, HALF_RANGE_UM, W, DAMPING)
    load_um = 1e3 * drive_um(np.arange(3000) * PERIOD_S)
    found_um = opening.apply(load_um, PERIOD_S)
    assert np.abs(found_um).max() < STIFFEST * np.abs(load_um).max()


def evidence(measured_um, modelled_um, seed=1):
    """Return what a recording shows beside a model whose error nothing else explains."""
    residual_um = measured_um - modelled_um

    def reduction(contributions):
        gains = np.linalg.lstsq(contributions, residual_um, rcond=None)[0]
        left = residual_um - contributions @ gains
        return gains, float(1.0 - (left @ left) / (residual_um @ residual_um))

    return Evidence(PERIOD_S, modelled_um, modelled_um, residual_um, 1e-3,
                    ElectricVibrationDynamics(0.0, (W,), (DAMPING,)), modelled_um, reduction,
                    lambda contribution: 1.0)


@pytest.fixture(scope="module")
def shown():
    """Return evidence from which a spring is guessed."""
    time_s = np.arange(4000) * PERIOD_S
    return evidence(solved(time_s, *SHAPES["opening"]), unloaded(time_s))


def test_a_guess_from_a_recording_of_the_integrator_explains_most_of_the_error(shown):
    linear_um = shown.displacement_um
    measured_um = linear_um + shown.residual_um
    guesses = HystereticSpring.starts(shown)
    left = [np.std(measured_um - guess.apply(linear_um, PERIOD_S, 0.0)) for guess in guesses]
    assert min(left) < 0.25 * np.std(measured_um - linear_um)


def test_nothing_is_guessed_where_the_mode_is_only_softer_and_damped_otherwise():
    time_s = np.arange(2000) * PERIOD_S
    softer_um = solved(time_s, -0.3, 0.05, 0.0, 0.0, 0.0, 1.0)
    assert HystereticSpring.starts(evidence(softer_um, unloaded(time_s))) == []


@pytest.mark.parametrize("changed", [
    {"sample_period_s": 10.0 * PERIOD_S},
    {"displacement_um": 4.0 * np.sin(5.0 * PERIOD_S * np.arange(4000))},
    {"displacement_um": np.zeros(4000)},
], ids=["samples too slow", "motion too slow", "no motion"])
def test_where_the_mode_does_not_show_nothing_is_guessed_and_nothing_is_asked_for(shown, changed):
    slow = replace(shown, **changed)
    assert HystereticSpring.starts(slow) == []
    # A lack of excitation would be listed as not decidable in every recording of a slow motion.
    assert HystereticSpring.lacks_excitation(slow) is None


def test_a_spring_that_gives_energy_is_refused():
    extent = Extent(8.0, -1.0, 1.0, 1.0, PERIOD_S)
    giving = HystereticSpring(0.0, -0.2, 0.2, 0.0, 0.5, 1.0, 0.0, HALF_RANGE_UM, W, DAMPING)
    assert "energy" in giving.impossible(extent)
    for shape in SHAPES.values():
        assert HystereticSpring(*shape, 0.0, HALF_RANGE_UM, W, DAMPING).impossible(extent) is None
