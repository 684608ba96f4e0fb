# SPDX-License-Identifier: BSD-3-Clause
"""Hysteresis and creep of one axis of several, fitted as those of a stage of one axis."""

import control
import numpy as np
import pytest

from piezo_identification.axes.actuator_estimate import estimate_actuators, fitted_alone
from piezo_identification.estimators.creep import slow_creep
from piezo_models.axes.actuator import Actuator
from piezo_models.axes.coupled import CoupledModel
from piezo_models.cascade import StageModel
from piezo_models.effects.bouc_wen_hysteresis import BoucWenHysteresis
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder import recording_of
from piezo_recorder.reading.axes import AxesRecording

PERIOD_S, ROWS, NOISE_UM, GAIN_UM_PER_V = 0.01, 800, 1e-3, 0.2
LINE = PreisachModel.line(0.0, 100.0, 1.0)
CREEP = CreepDynamics((0.8,), (0.82,))
LOOPS = PreisachModel(0.0, 100.0, np.tril(np.full((20, 20), 4e-3)), 0.0, np.full(20, 1.0))


def moved(actuator, rows=ROWS):
    """Return recordings of loops of an actuator at two speeds."""
    time_s, rng, found = PERIOD_S * np.arange(rows), np.random.default_rng(3), []
    for turns_per_s in (0.35, 0.9):
        voltage_v = 50.0 * (1.0 - np.cos(2.0 * np.pi * turns_per_s * time_s)
                            * np.exp(-0.3 * turns_per_s * time_s))
        found.append(recording_of({
            "time_s": time_s, "voltage_v": voltage_v,
            "displacement_um": GAIN_UM_PER_V * actuator.drive_v(voltage_v, PERIOD_S)
            + NOISE_UM * rng.normal(size=rows)}))
    return found


def start(hysteresis):
    """Return a start with creep that is off."""
    return StageModel(hysteresis.scaled(GAIN_UM_PER_V), CreepDynamics((0.5,), (0.51,)),
                      ElectricVibrationDynamics())


def test_loops_that_drift_are_explained_by_a_bouc_wen_hysteresis():
    true = BoucWenHysteresis(6.0, 20.0, unloading=1.4)
    found = fitted_alone(start(LOOPS), moved(Actuator(LINE, CREEP, bouc_wen=true)), is_line=False)
    assert found.bouc_wen.saturation_v == pytest.approx(6.0, rel=0.02)
    assert found.bouc_wen.relaxation_v == pytest.approx(20.0, rel=0.02)
    assert found.bouc_wen.unloading == pytest.approx(1.4, rel=0.05)
    assert found.creep.poles_rad_per_s == pytest.approx((0.8,), rel=0.2)


def test_loops_that_close_stay_preisach_loops():
    found = fitted_alone(start(LOOPS), moved(Actuator(LOOPS, CREEP)), is_line=False)
    assert found.bouc_wen is None
    assert found.creep.poles_rad_per_s == pytest.approx((0.8,), rel=0.2)


def test_where_no_loops_are_shown_there_is_no_hysteresis(monkeypatch):
    rate = 2.0 * np.pi * 60.0
    mode = control.tf(GAIN_UM_PER_V * rate**2, [1.0, 0.1 * rate, rate**2])
    model = CoupledModel.from_control(
        control.append(*2 * [control.sample_system(control.ss(mode), PERIOD_S / 4.0)]),
        ("x", "y"), [50.0, 50.0], [10.0, 10.0])
    time_s, rng = PERIOD_S / 4.0 * np.arange(ROWS), np.random.default_rng(3)
    voltage_v = 50.0 * np.column_stack([1.0 - np.cos(4.0 * np.pi * time_s), 0.0 * time_s])
    moved_um = model.simulate(voltage_v)
    loops = AxesRecording("loops", ("x", "y"), PERIOD_S / 4.0, voltage_v,
                          moved_um + NOISE_UM * rng.normal(size=voltage_v.shape))
    monkeypatch.setattr(slow_creep, "CELLS", 8)
    actuators = estimate_actuators(model, [loops], [loops], 6)
    assert not any(each.hysteresis or each.creep.poles_rad_per_s for each in actuators)


def test_a_start_stays_as_it_is_where_a_recording_is_too_short():
    given = start(LOOPS)
    found = fitted_alone(given, moved(Actuator(LOOPS, CREEP), rows=80), is_line=False)
    assert found.hysteresis is given.hysteresis
    assert found.creep == given.creep
