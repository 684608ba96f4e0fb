# SPDX-License-Identifier: BSD-3-Clause
"""Hysteresis and creep in front of shared modes, and slow rows of fast modes."""

from dataclasses import replace

import control
import numpy as np
import pytest

from piezo_models.axes.actuator import Actuator
from piezo_models.axes.coupled import CoupledModel
from piezo_models.effects.bouc_wen_hysteresis import BoucWenHysteresis
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics

PERIOD_S = 1e-3
CREEP = CreepDynamics((0.5, 8.0), (0.52, 8.2))


def play(half_width_v, weight, cells=20):
    """Return a voltage from 0 to 10 V with a play beside it, as Preisach hysteresis."""
    density = np.zeros((cells, cells))
    away = round(2.0 * half_width_v * cells / 10.0)
    density[np.arange(away, cells), np.arange(cells - away)] = weight * cells / 10.0
    return PreisachModel(0.0, 10.0, density, 3.0, np.full(cells, 1.0 - weight))


def modes():
    """Return two lightly damped modes that both axes share."""
    s, push = control.tf("s"), np.array([[0.2, 0.006], [-0.005, 0.2]])
    each = [control.ss(w**2 / (s**2 + 0.02 * w * s + w**2)) for w in (190.0, 250.0)]
    stage = control.append(*each) * control.ss([], [], [], push)
    return CoupledModel.from_control(control.sample_system(stage, PERIOD_S), ("x", "y"))


def test_over_the_range_the_drive_changes_by_as_much_as_the_voltage():
    actuator = Actuator(play(1.0, 0.3))
    voltage_v = np.concatenate([np.linspace(0.0, 10.0, 101), np.linspace(10.0, 0.0, 101)])
    passed_v = actuator.passed_v(voltage_v)
    assert passed_v[0] == pytest.approx(0.0, abs=1e-12)
    assert passed_v[100] == pytest.approx(10.0)
    # The play is closed on the way back: 2 V of it later.
    assert np.ptp(passed_v[[50, 151]]) == pytest.approx(0.3 * 2.0 / actuator.slope_um_per_v)


def test_beyond_the_range_the_drive_follows_the_voltage():
    passed_v = Actuator(play(1.0, 0.3)).passed_v(np.array([0.0, 10.0, 12.5, 10.0, 0.0, -1.0]))
    assert passed_v[2] - passed_v[1] == pytest.approx(2.5)
    assert passed_v[5] - passed_v[4] == pytest.approx(-1.0)


def test_a_held_voltage_creeps_by_the_gains_of_the_poles():
    drive_v = Actuator(creep=CREEP).drive_v(np.repeat([0.0, 1.0], [1, 20_000]), PERIOD_S)
    zeros, poles = np.array(CREEP.zeros_rad_per_s), np.array(CREEP.poles_rad_per_s)
    assert drive_v[1] == pytest.approx(1.0, abs=1e-3)
    assert drive_v[-1] == pytest.approx(np.prod(zeros / poles), rel=1e-4)


DRIFTING = Actuator(PreisachModel.line(0.0, 10.0, 1.0),
                    bouc_wen=BoucWenHysteresis(0.6, 2.0, unloading=1.0))


@pytest.mark.parametrize(("actuator", "largest_v"), [
    (Actuator(play(1.0, 0.3), CREEP), 1e-9), (DRIFTING, 1e-4)], ids=["play", "drifting loops"])
def test_the_inverse_repeats_a_drive(actuator, largest_v):
    turn = 2.0 * np.pi * np.arange(400) / 400
    wanted_v = 5.0 + 3.0 * np.sin(turn) + 0.5 * np.cos(3.0 * turn)
    voltage_v = actuator.inverse_v(wanted_v, PERIOD_S)
    found_v = actuator.drive_v(voltage_v, PERIOD_S, periodic=True)
    np.testing.assert_allclose(found_v, wanted_v, atol=largest_v)
    assert np.ptp(voltage_v - wanted_v) > 0.1


def test_loops_that_drift_begin_where_the_past_left_them():
    # From either end of the range, what is taken is saturated; the equation of Dahl then decays.
    up_v = np.linspace(0.0, 10.0, 101)
    rising_v = DRIFTING.passed_v(up_v, past="rising")
    left_v = 0.6 * (1.0 - np.exp(-5.0))
    taken_v = 0.6 - (0.6 + left_v) * np.exp(-up_v / 2.0)
    np.testing.assert_allclose(rising_v, up_v - taken_v, atol=1e-2)
    falling_v = DRIFTING.passed_v(up_v[::-1].copy(), past="falling")
    np.testing.assert_allclose(10.0 - falling_v, rising_v, atol=1e-2)


def test_loops_that_drift_need_a_range():
    with pytest.raises(ValueError, match="range"):
        Actuator(bouc_wen=DRIFTING.bouc_wen)


@pytest.mark.parametrize("late", [(0, 0), (0, 3)])
def test_rows_of_held_voltages_are_those_of_the_fast_model(late):
    fast = replace(modes(), latency_samples=np.array(late))
    rows_v = np.vstack([np.zeros((3, 2)), np.random.default_rng(0).normal(size=(60, 2))])
    slow = fast.at_period(7.0 * PERIOD_S)
    np.testing.assert_allclose(slow.simulate(rows_v),
                               fast.simulate(np.repeat(rows_v, 7, axis=0))[::7], atol=1e-12)


@pytest.mark.parametrize("late", [(0, 0), (0, 3)])
@pytest.mark.parametrize(("creep", "off"), [(CreepDynamics(), 1e-12), (CREEP, 1e-3)])
def test_rows_of_voltages_that_go_on_are_those_of_the_fast_model(late, creep, off):
    # Creep of held voltages is ahead by half a sample.
    fast = replace(modes(), latency_samples=np.array(late), actuators=(Actuator(creep=creep),) * 2)
    rows_v = np.vstack([np.zeros((3, 2)), np.random.default_rng(0).normal(size=(60, 2))])
    samples = np.arange(62 * 70 + 1) / 70.0
    fast_v = np.column_stack([np.interp(samples, np.arange(63.0), each) for each in rows_v.T])
    slow = fast.at_period(70.0 * PERIOD_S, goes_on=True)
    np.testing.assert_allclose(slow.simulate(rows_v, goes_on=True),
                               fast.simulate(fast_v)[::70], atol=off)


def test_as_many_actuators_as_axes_are_asked_for():
    with pytest.raises(ValueError, match="actuators"):
        replace(modes(), actuators=(Actuator(),))
