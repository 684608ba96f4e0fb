# SPDX-License-Identifier: BSD-3-Clause
"""The simulated makes agree with what is known of their parts in closed form."""

from math import gamma

import numpy as np
import pytest
from scipy.signal import StateSpace, TransferFunction, cont2discrete, dlsim, lsim

from piezo_studies.other_makes.hystereses import Duhem, JilesAtherton, MaxwellSlip, Plays
from piezo_studies.other_makes.linear_system import (
    HeldVoltage,
    Stage,
    coupled_flexures,
    fractional_creep,
    knots_s,
    lag,
    logarithmic_creep,
    mode,
    power_creep,
)
from piezo_studies.other_makes.makes import MAKES

PERIOD_S = 5e-5
CREEPING_RAD_PER_S = np.geomspace(1e-3, 1e2, 30)
PLAYS = Plays(np.linspace(0.0, 20.0, 8), np.full(8, 0.02), (1.0, 1.2e-3), (1.02, 1e-3))
MAXWELL = MaxwellSlip(2.0, np.full(8, 0.05), np.linspace(1.0, 30.0, 8))


def line(voltage_v):
    return voltage_v


def parallel_modes():
    return mode(1200.0, 0.02, 0.85).parallel_to(mode(1900.0, 0.015, 0.15))


def as_scipy(frequency_hz, damping, share=1.0):
    w = 2.0 * np.pi * frequency_hz
    return TransferFunction([share * w**2], [1.0, 2.0 * damping * w, w**2])


def test_a_held_voltage_gives_the_samples_of_the_exact_discrete_system():
    voltage_v = np.random.default_rng(1).uniform(0.0, 100.0, 300)
    voltage_v[:2] = 0.0
    mine_um = Stage(line, parallel_modes()).displacement_um([], HeldVoltage(voltage_v, PERIOD_S))
    expected_um = 0.0
    for system in (as_scipy(1200.0, 0.02, 0.85), as_scipy(1900.0, 0.015, 0.15)):
        b, a, _ = cont2discrete((system.num, system.den), PERIOD_S)
        expected_um = expected_um + dlsim((b, a, PERIOD_S), voltage_v)[1].ravel()
    assert mine_um == pytest.approx(expected_um, abs=1e-9)


@pytest.mark.parametrize("front", [lag(5e-5), mode(15e3, 0.75)])
@pytest.mark.parametrize("delay_s", [0.0, 3.4 * PERIOD_S])
def test_an_amplifier_and_a_delay_agree_with_fine_steps(front, delay_s):
    """Straight lines between few instants of a row are those of two hundred steps in each."""
    finer = 200
    voltage_v = np.repeat(np.random.default_rng(2).uniform(0.0, 100.0, 40), 3)
    voltage_v[:6] = 0.0
    stage = Stage(PLAYS, parallel_modes(), front, delay_s)
    mine_um = stage.displacement_um([], HeldVoltage(voltage_v, PERIOD_S))
    fine = Stage(PLAYS, parallel_modes(), front)
    fine_um = fine.displacement_um([], HeldVoltage(np.repeat(voltage_v, finer), PERIOD_S / finer))
    late = round(delay_s / PERIOD_S * finer)
    expected_um = np.append(np.zeros(late), fine_um)[: fine_um.size : finer]
    assert mine_um == pytest.approx(expected_um, abs=2e-5 * np.ptp(expected_um))


def test_a_past_is_the_beginning_of_one_recording():
    voltage_v = np.random.default_rng(3).uniform(0.0, 100.0, 200)
    stage = Stage(PLAYS, logarithmic_creep(0.01).then(parallel_modes()), lag(5e-5))
    whole_um = stage.displacement_um([], HeldVoltage(voltage_v, PERIOD_S))
    later_um = stage.displacement_um([HeldVoltage(voltage_v[:80], PERIOD_S)],
                                     HeldVoltage(voltage_v[80:], PERIOD_S))
    assert later_um == pytest.approx(whole_um[80:], abs=1e-9)


def test_coupled_flexures_agree_with_their_equations_of_motion():
    mass, stiffness = np.diag([1.0, 0.4]), 1e6 * np.array([[3.0, -1.4], [-1.4, 1.4]])
    damping = 2e-5 * stiffness + 5.0 * mass
    force, reading = np.array([1.0, 0.0]), np.array([0.0, 1.0])
    system = coupled_flexures(mass, damping, stiffness, force, reading, 0.03)
    a = np.block([[np.zeros((2, 2)), np.eye(2)],
                  [-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damping)]])
    b = np.append(np.zeros(2), np.linalg.solve(mass, force))[:, None]
    c = np.append(reading, np.zeros(2))[None]
    time_s = 1e-5 * np.arange(3000)
    _, moved, _ = lsim(StateSpace(a, b, c, 0.0), np.ones(time_s.size), time_s)
    static = (-c @ np.linalg.solve(a, b)).item()
    stepped = Stage(line, system).displacement_um([], HeldVoltage(np.ones(time_s.size), 1e-5))
    assert stepped == pytest.approx(0.03 + 0.97 * moved / static, abs=1e-8)


def test_a_series_multiplies_transfer_functions():
    first, second, s = logarithmic_creep(0.01), parallel_modes(), 1j * np.geomspace(1e-2, 1e5, 40)
    np.testing.assert_allclose(first.then(second).at(s), first.at(s) * second.at(s), rtol=1e-9)


@pytest.mark.parametrize(("creep", "expected"), [
    (power_creep(0.02, 0.15), lambda s: 1.0 + 0.02 * gamma(1.15) * s**-0.15),
    (fractional_creep(0.08, 20.0, 0.4), lambda s: 1.0 + 0.08 / (1.0 + (20.0 * s) ** 0.4)),
], ids=["power of time", "fractional"])
def test_creep_has_the_transfer_function_of_its_law(creep, expected):
    s = 1j * CREEPING_RAD_PER_S
    np.testing.assert_allclose(creep.at(s), expected(s), atol=2e-4)


def test_creep_by_the_logarithm_grows_alike_in_every_decade():
    stepped = Stage(line, logarithmic_creep(0.012)).displacement_um(
        [HeldVoltage(np.ones(100), 1e-3)], HeldVoltage(np.ones(2001), 0.5))
    assert stepped[2000] - stepped[200] == pytest.approx(0.012, rel=2e-3)
    assert stepped[200] - stepped[20] == pytest.approx(0.012, rel=1e-2)


def through(*turns_v):
    return np.concatenate([np.linspace(start, end, 400)
                           for start, end in zip(turns_v[:-1], turns_v[1:], strict=True)])


@pytest.mark.parametrize("hysteresis", [PLAYS, MAXWELL], ids=["plays", "Maxwell"])
def test_plays_and_blocks_return_to_the_point_where_a_loop_left(hysteresis):
    driven_um = hysteresis(through(0.0, 90.0, 30.0, 60.0, 40.0, 60.0, 30.0))
    assert driven_um[3 * 400 - 1] == pytest.approx(driven_um[5 * 400 - 1], abs=1e-12)
    assert driven_um[2 * 400 - 1] == pytest.approx(driven_um[6 * 400 - 1], abs=1e-12)
    assert np.ptp(driven_um[[800 + 200, 1600 + 200]]) > 1e-3 * np.ptp(driven_um)


@pytest.mark.parametrize("hysteresis", [
    PLAYS, MAXWELL, Duhem(0.2, 0.2, 0.4, 0.03, 0.5),
    JilesAtherton(0.22, 10.0, 35.0, 12.0, 0.5, 0.2, 50.0)],
    ids=["plays", "Maxwell", "Duhem", "Jiles-Atherton"])
def test_a_hysteresis_knows_no_time_and_its_large_loop_lags_and_closes(hysteresis):
    voltage_v = through(0.0, 100.0, 0.0, 100.0, 0.0, 100.0, 0.0)
    driven_um = hysteresis(voltage_v)
    assert driven_um[3 * 400 - 1] == pytest.approx(driven_um[5 * 400 - 1],
                                                   abs=2e-3 * np.ptp(driven_um))
    assert driven_um[5 * 400 + 200] - driven_um[4 * 400 + 200] > 0.02 * np.ptp(driven_um)
    held_um = hysteresis(np.repeat(voltage_v, 3))
    assert held_um[2::3] == pytest.approx(driven_um, abs=1e-12)


def test_duhem_does_not_depend_on_the_steps():
    duhem = Duhem(0.2, 0.2, 0.4, 0.03, 0.5)
    fine_um = duhem(through(0.0, 90.0, 20.0))
    assert duhem(np.array([90.0, 20.0])) == pytest.approx(fine_um[[399, 799]], abs=1e-12)


def test_jiles_atherton_reaches_its_curve_without_hysteresis_as_a_field_fades():
    domains = JilesAtherton(0.0, 10.0, 35.0, 12.0, 0.0, 0.2, 0.0)
    swings_v = 150.0 * 0.97 ** np.arange(200) * (-1.0) ** np.arange(200)
    faded_um = domains(20.0 + np.append(swings_v, 0.0))[-1]
    assert faded_um == pytest.approx(10.0 * (1.0 / np.tanh(20 / 35) - 35 / 20), abs=0.05)


def test_rows_hold_the_instant_at_which_they_are_read():
    knots = knots_s(1e-3, 2e4, 3.3e-4)
    assert {0.0, 3.3e-4, 1e-3} <= set(knots.tolist())
    assert (np.diff(knots) > 0.0).all()


@pytest.mark.parametrize("name", MAKES)
def test_a_seed_draws_one_make(name):
    nominal, drawn = MAKES[name](0), MAKES[name](5)
    assert drawn.true == MAKES[name](5).true
    assert drawn.true.keys() == nominal.true.keys()
    assert drawn.true != nominal.true
    assert drawn.stage.behind.at(0.0).real == pytest.approx(
        nominal.stage.behind.at(0.0).real, rel=0.5)
