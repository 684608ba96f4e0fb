# SPDX-License-Identifier: BSD-3-Clause
"""Loops that a Preisach model can make are let through, and others are refused by name."""

import os
from pathlib import Path

import numpy as np
import pytest

from piezo_identification.adequacy.loop_shape import refuse_impossible_loops
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder.reading.reader import read_recording

NOISE_UM = 0.02
PERIOD_S = 0.05
NO_CREEP = CreepDynamics()
DATA = Path(os.environ.get("MEASURED_DATA", "../shared/data"))


def ways(*turns_v, samples=150):
    parts = [np.linspace(start, end, samples, endpoint=False)
             for start, end in zip(turns_v[:-1], turns_v[1:], strict=True)]
    return np.concatenate([*parts, turns_v[-1:]])


NESTED_V = ways(0, 100, 0, 60, 20, 80, 10, 100, 50, 90, 0)
BIPOLAR_V = ways(0, 100, -100, 100, -100, 0)


@pytest.fixture
def check(recorded):
    def check(voltage_v, displacement_um, period_s=PERIOD_S, creep=NO_CREEP, delay_s=0.0):
        return refuse_impossible_loops(
            recorded("loops", voltage_v, displacement_um, period_s, NOISE_UM),
            creep, ElectricVibrationDynamics(), delay_s)
    return check


@pytest.mark.parametrize("settings", [{}, {"creep_gains": (0.0, 0.0)}, {"plays": False}],
                         ids=["creeping", "static", "without hysteresis"])
def test_loops_of_a_stage_are_let_through(independent_stage, check, settings):
    stage = independent_stage(**settings)
    for voltage_v in (NESTED_V, BIPOLAR_V, NESTED_V[::8]):
        assert check(voltage_v, stage.displacement_um(voltage_v, PERIOD_S)) == []


def test_levels_between_which_the_voltage_jumps_are_let_through(independent_stage, check):
    """The row of a jump shows the displacement before it, and no row that within it."""
    levels_v = np.random.default_rng(8).uniform(0.0, 100.0, 40)
    voltage_v = np.repeat(levels_v, 20)
    displacement_um = independent_stage().displacement_um(voltage_v, PERIOD_S)
    for displaced_um in (displacement_um, np.append(displacement_um[0], displacement_um[:-1])):
        assert check(voltage_v, displaced_um) == []


@pytest.mark.parametrize(("wrong", "name"), [
    ({"delay_s": -0.3}, "a butterfly loop"),
    ({"delay_s": 0.15}, "loops that are run through clockwise"),
    ({"creep": CreepDynamics((0.5,), (5.0,))}, "loops that are run through clockwise"),
], ids=["delay of the other sign", "long delay", "large creep"])
def test_loops_are_not_refused_for_what_is_taken_out_wrongly(
        independent_stage, check, wrong, name):
    voltage_v = NESTED_V[::4]
    told = check(voltage_v, independent_stage().displacement_um(voltage_v, PERIOD_S), **wrong)
    assert any(each.startswith("once creep and dynamics are taken out, ")
               and f"loops holds {name}" in each for each in told)


def test_a_butterfly_that_creeps_and_is_late_is_refused(independent_stage, check):
    polarisation = independent_stage().displacement_um(BIPOLAR_V, PERIOD_S)
    for creep, delay_s in ((CreepDynamics((0.125,), (0.13,)), 0.0), (NO_CREEP, 0.01)):
        with pytest.raises(ValueError, match="loops holds a butterfly loop"):
            check(BIPOLAR_V, 0.05 * polarisation**2, creep=creep, delay_s=delay_s)


def test_a_butterfly_is_refused_by_name(independent_stage, check):
    """Strain of a ferroelectric that is poled over: the square of its polarisation."""
    polarisation = independent_stage().hysteresis_um(BIPOLAR_V)
    with pytest.raises(ValueError, match="loops holds a butterfly loop: .* keep the voltage"):
        check(BIPOLAR_V, 0.05 * polarisation**2)


def test_a_turn_on_rising_branches_alone_is_no_butterfly(independent_stage, check):
    rising = np.gradient(NESTED_V) > 0.0
    displacement_um = independent_stage().hysteresis_um(NESTED_V)
    bent_um = displacement_um - rising * 8.0 * np.exp(-(((NESTED_V - 60.0) / 8.0) ** 2))
    with pytest.raises(ValueError, match="no loop that is monotone in the voltage"):
        check(NESTED_V, bent_um)


def test_few_branches_that_ring_raise_a_doubt(independent_stage, check):
    voltage_v = ways(*([0, 100] * 12), 0)
    displacement_um = independent_stage().hysteresis_um(voltage_v)
    rings = (np.arange(voltage_v.size) // 150 == 4)
    told = check(voltage_v, displacement_um - rings * 30.0 * np.exp(
        -(((voltage_v - 60.0) / 8.0) ** 2)))
    assert len(told) == 1
    assert "on 1 of 24 branches" in told[0] and "on few branches or none" in told[0]


def test_clockwise_loops_are_refused_by_name(independent_stage, check):
    displacement_um = independent_stage().hysteresis_um(NESTED_V)
    with pytest.raises(ValueError, match="run through clockwise"):
        check(NESTED_V, 0.6 * NESTED_V - displacement_um + displacement_um.min())


def test_minor_loops_that_do_not_close_are_refused(independent_stage, check):
    voltage_v = ways(0, 100, *([40, 80] * 8), 0)
    displacement_um = independent_stage().hysteresis_um(voltage_v)
    # A ratchet: what rises does not all come back.
    gained_um = 0.6 * np.cumsum(np.maximum(np.diff(displacement_um, prepend=0.0), 0.0))
    with pytest.raises(ValueError, match="minor loops that do not close"):
        check(voltage_v, displacement_um + gained_um * (np.arange(voltage_v.size) > 300))


def test_fast_loops_are_not_judged_by_their_shape(independent_stage, check):
    polarisation = independent_stage().hysteresis_um(BIPOLAR_V)
    check(BIPOLAR_V, 0.05 * polarisation**2, period_s=1e-4)


@pytest.mark.parametrize("name", [
    "piezo_scanner/nested_minor_loops.csv", "piezo_scanner/major_loops.csv",
    "piezo_cantilever/rest_jump_sine.csv"])
def test_measured_loops_are_let_through(name):
    path = DATA / name
    if not path.exists():
        pytest.skip(f"{path} is not here: give its folder as MEASURED_DATA")
    recording = read_recording(path)
    if np.corrcoef(recording.voltage_v, recording.displacement_um)[0, 1] < 0.0:
        pytest.skip("the sign is changed before")
    refuse_impossible_loops(recording, CreepDynamics(), ElectricVibrationDynamics())
