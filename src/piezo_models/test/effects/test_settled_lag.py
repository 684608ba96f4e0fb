# SPDX-License-Identifier: BSD-3-Clause
"""A lag in front of the hysteresis that has settled long before the next row."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter, ss2tf

from piezo_models.cascade import StageModel
from piezo_models.effects.amplifier_lag import SETTLED, AmplifierLag, SettledLag
from piezo_models.effects.bouc_wen_hysteresis import BoucWenHysteresis
from piezo_models.effects.second_order_amplifier import SecondOrderAmplifier
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics

ROW_S, FINE, LAG_S = 1e-3, 1000, 15e-6
RATE, DAMPING = 25.5e3, 0.01


def stage(effects=(), rate=RATE):
    """Return a stage whose mode rings some four times within a row, or at another rate."""
    return StageModel(
        PreisachModel(0.0, 100.0, np.tril(np.full((20, 20), 4e-3)), 0.0, np.full(20, 0.02)),
        CreepDynamics((1.0,), (1.02,)), ElectricVibrationDynamics(0.0, (rate,), (DAMPING,)),
        effects=effects)


def staircase_v():
    up = np.arange(0.0, 60.0, 3.0)
    return np.concatenate([np.zeros(20), up, np.full(30, 60.0), up[::-1], np.zeros(30)])


def discrete(system):
    """Return the matrices of a linear system under values that are held for a fine step."""
    return cont2discrete((system.A, system.B, system.C, system.D), ROW_S / FINE)[:4]


def moved_from(state, system, held):
    """Return the output of a linear system, all of whose poles differ."""
    step, drive, *_ = discrete(system)
    poles, shapes = np.linalg.eig(step)
    pushes, states = np.linalg.solve(shapes, np.column_stack([drive[:, 0], state])).T
    parts = [lfilter([0.0, push], [1.0, -pole], held, zi=[state])[0]
             for pole, push, state in zip(poles, pushes, states, strict=True)]
    return ((system.C @ shapes)[0] @ parts).real + system.D[0, 0] * held


def finely_simulated_um(effect, voltage_v, rate=RATE):
    """Return the displacement of rows of which each is a thousand steps of the whole cascade."""
    held_v = np.repeat(voltage_v, FINE)
    numerator, denominator = ss2tf(*discrete(effect.lag()))
    behind_v = lfilter(numerator[0], denominator, held_v)
    still = stage(rate=rate)
    memory = still.memory(0.0)
    moved_um = still.hysteresis.simulate(behind_v, memory.hysteresis)
    return moved_from(memory.linear_state, still.linear(), moved_um)[::FINE]


@pytest.mark.parametrize("effect", [
    AmplifierLag(LAG_S), pytest.param(SecondOrderAmplifier(LAG_S, 0.5), marks=pytest.mark.long)],
    ids=["first", "second"])
def test_what_rings_within_a_row_has_the_phase_of_the_lag(effect):
    voltage_v = staircase_v()
    true_um = finely_simulated_um(effect, voltage_v)
    ringing_um = np.ptp(true_um[45:60] - true_um[60])
    found_um = stage((effect,)).simulate(voltage_v, ROW_S)
    assert np.abs(found_um - true_um).max() < 0.06 * ringing_um
    at_once_um = stage().simulate(voltage_v, ROW_S)
    assert np.abs(at_once_um - true_um).max() > 0.9 * ringing_um


@pytest.mark.parametrize("quality_factor", [
    pytest.param(0.7, marks=pytest.mark.long), 1.5])
def test_the_hysteresis_remembers_an_overshoot_within_a_row(quality_factor):
    effect = SecondOrderAmplifier(LAG_S, quality_factor)
    voltage_v = np.repeat([10.0, 50.0, 20.0, 60.0, 30.0], 20)
    true_um = finely_simulated_um(effect, np.append(np.zeros(10), voltage_v))[10:]
    model = stage((effect,))
    memory = model.memory(0.0)
    model.simulate(np.zeros(10), ROW_S, memory)
    found_um = model.simulate(voltage_v, ROW_S, memory)
    standing = np.arange(voltage_v.size) % 20 >= 15
    # A lag without overshoot is what the hysteresis saw before.
    forgotten_um = stage((AmplifierLag(LAG_S),)).simulate(voltage_v, ROW_S)
    error_um, forgotten_um = (
        np.abs(each - true_um)[standing].max() for each in (found_um, forgotten_um))
    assert error_um < 0.05 * forgotten_um


def test_a_hysteresis_that_drifts_remembers_it_too_also_from_part_to_part():
    amplifier, loops = SecondOrderAmplifier(LAG_S, 1.5), BoucWenHysteresis(5.0, 20.0)
    voltage_v = np.append(np.zeros(10), np.repeat([10.0, 50.0, 20.0, 60.0, 30.0], 20))
    numerator, denominator = ss2tf(*discrete(amplifier.lag()))
    behind_v = lfilter(numerator[0], denominator, np.repeat(voltage_v, FINE))
    true_um = 0.2 * loops.apply(behind_v, ROW_S / FINE)[::FINE]
    model = StageModel(PreisachModel.line(0.0, 100.0, 0.2), CreepDynamics((), ()),
                       ElectricVibrationDynamics(), effects=(amplifier, loops))
    memory = model.memory(0.0)
    found_um = np.concatenate([
        model.simulate(part_v, ROW_S, memory) for part_v in np.array_split(voltage_v, 9)])
    forgotten_um = replace(model, effects=(AmplifierLag(LAG_S), loops)).simulate(voltage_v, ROW_S)
    standing = (np.arange(voltage_v.size) - 10) % 20 >= 15
    error_um, of_none_um = (np.abs(each - true_um)[standing].max()
                            for each in (found_um, forgotten_um))
    assert error_um < 0.05 * of_none_um


@pytest.mark.parametrize("rows", [
    0.2, *(pytest.param(rows, marks=pytest.mark.long) for rows in (0.1, 0.5))])
def test_a_lag_of_a_part_of_a_row_is_followed_within_it(rows):
    """A mode rings half a period in a row."""
    rate, effect, voltage_v = np.pi / ROW_S, AmplifierLag(rows * ROW_S), staircase_v()
    true_um = finely_simulated_um(effect, voltage_v, rate)
    ringing_um = np.ptp(true_um[45:60] - true_um[60])
    found_um = stage((effect,), rate).simulate(voltage_v, ROW_S)
    assert np.abs(found_um - true_um).max() < 0.01 * ringing_um


def test_an_amplifier_that_rings_over_several_rows_is_followed_within_them():
    effect = SecondOrderAmplifier(0.03 * ROW_S, 13.0)
    voltage_v = np.repeat([0.0, 50.0, 20.0], 20)
    true_um = finely_simulated_um(effect, voltage_v)
    found_um, at_once_um = (
        stage(effects).simulate(voltage_v, ROW_S) for effects in ((effect,), ()))
    error_um, of_none_um = (np.abs(each - true_um).max() for each in (found_um, at_once_um))
    assert error_um < 0.05 * of_none_um


def test_parts_of_a_simulation_are_the_whole():
    model = stage((AmplifierLag(LAG_S),))
    voltage_v, memory = staircase_v(), model.memory(0.0)
    whole_um = model.simulate(voltage_v, ROW_S, model.memory(0.0))
    parts_um = [model.simulate(part_v, ROW_S, memory) for part_v in np.array_split(voltage_v, 7)]
    assert np.concatenate(parts_um) == pytest.approx(whole_um, abs=1e-6)


def test_only_a_lag_that_settles_within_the_row_acts_behind_the_hysteresis():
    model = stage((AmplifierLag(LAG_S),))
    assert model.as_rows_show(0.99 * LAG_S / SETTLED) is model
    assert [type(effect) for effect in model.as_rows_show(ROW_S).effects] == [SettledLag]
    without = replace(model, effects=())
    assert without.as_rows_show(ROW_S) is without
