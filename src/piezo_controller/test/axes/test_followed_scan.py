# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import replace

import numpy as np
import pytest

from piezo_controller.axes.followed_scan import REST_S, AxesStage, followed_scan
from piezo_controller.axes.stored_scan import StoredScan
from piezo_models.feedback_law.axes_law import AxesLaw
from piezo_models.feedback_law.feedback_law import DeclaredPlant, LinearBlock

AXES, PERIOD_S = ("x", "y"), 1e-4
TURN = 2.0 * np.pi * np.arange(250) / 250
POSITION_UM = 10.0 + np.column_stack([4.0 * np.cos(TURN), 2.0 * np.sin(TURN)])
ONE = np.eye(2)
LAW = AxesLaw(
    AXES, PERIOD_S, 10, LinearBlock(ONE, ONE, ONE, 0.0 * ONE), 0.1 * ONE,
    DeclaredPlant(LinearBlock(0.5 * ONE, ONE, 0.5 * ONE, 0.0 * ONE), np.array([[0.2, 0.3]])),
    np.array([10.0, 9.0]), {}, {})
SCAN = StoredScan(AXES, PERIOD_S, np.linspace([50.0, 40.0], [70.0, 50.0], 200),
                  POSITION_UM / 0.2, POSITION_UM)
REST_V, RAMP_V_PER_S = [0.0, 10.0], [1000.0, 500.0]
STAGE = AxesStage(AXES, PERIOD_S, 10, np.array([[-20.0, 120.0]] * 2), np.array(REST_V),
                  np.array(RAMP_V_PER_S))


def test_run_goes_from_rest_along_the_plan_for_whole_ticks():
    run = followed_scan(SCAN, STAGE, 3 * 250, LAW, 12.0)
    once_v = run.once_voltage_v
    assert np.array_equal(once_v[0], REST_V)
    steps = np.abs(np.diff(once_v[:-200], axis=0)).max(axis=0) / PERIOD_S
    assert np.all(steps <= np.array(RAMP_V_PER_S) * (1 + 1e-9)) and steps.max() > 500.0
    rest = once_v[-200 - round(REST_S / PERIOD_S):-200]
    assert np.all(rest == SCAN.begin_voltage_v[0])
    assert np.array_equal(once_v[-200:], SCAN.begin_voltage_v)
    assert run.period_voltage_v is SCAN.voltage_v
    assert run.period_marks is SCAN.marks
    assert followed_scan(SCAN, STAGE, 3 * 250).law is None
    played = len(once_v) + 3 * 250
    assert played <= run.samples < played + 10 and run.samples == 10 * run.ticks


def test_law_expects_the_path_and_acts_from_its_first_period_on():
    run = followed_scan(SCAN, STAGE, 250, LAW, 12.0)
    law = run.law
    assert law.start_sample == len(law.once_um) == len(run.once_voltage_v)
    assert np.array_equal(law.period_um, POSITION_UM)
    assert np.all(law.once_um[:-200] == LAW.operating_displacement_um)
    before_um = np.concatenate([law.once_um[-201:], POSITION_UM[:1]])
    assert np.abs(np.diff(before_um, axis=0)).max() < 0.2  # without a jump into the path
    assert (law.max_feedback_v, law.max_error_um) == (12.0, pytest.approx(2.4))


@pytest.mark.parametrize("changes", [{"axes": ("y", "x")}, {"sample_period_s": 2.5e-5}])
def test_law_of_another_model_and_a_path_for_another_stage_are_refused(changes):
    with pytest.raises(ValueError, match="the law has the axes .*, the stage the axes x, y at 1"):
        followed_scan(SCAN, STAGE, 250, replace(LAW, **changes))
    with pytest.raises(ValueError, match="the scan has the axes x, y at 10000 Hz, the st"):
        followed_scan(SCAN, replace(STAGE, **changes), 250)
