# SPDX-License-Identifier: BSD-3-Clause
"""Linear parts go to python-control and come back as they were."""

import warnings
from dataclasses import replace

import control
import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st

from piezo_models.cascade import StageModel
from piezo_models.control_objects import LeftOut, from_control, to_control, with_linear_part
from piezo_models.effects.amplifier_lag import AmplifierLag
from piezo_models.effects.delay import Delay
from piezo_models.effects.voltage_clipping import VoltageClipping
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics

pytestmark = pytest.mark.kernels

CREEP = CreepDynamics((0.0142, 0.31, 17.6), (0.0145, 0.33, 18.1))
DYNAMICS = ElectricVibrationDynamics(0.00049, (2846.0, 4909.0), (0.6853, 0.082), (3900.0,), (0.1,))


def model(creep=CREEP, dynamics=DYNAMICS):
    return StageModel(PreisachModel(-20.0, 120.0, np.array([[0.01]]), 0.0), creep, dynamics)


def test_creep_and_dynamics_come_back_from_python_control():
    creep, dynamics, gain, delay_s = from_control(to_control(model()))
    assert creep.poles_rad_per_s == pytest.approx(CREEP.poles_rad_per_s, rel=1e-6)
    assert creep.zeros_rad_per_s == pytest.approx(CREEP.zeros_rad_per_s, rel=1e-6)
    assert dynamics.time_constant_s == pytest.approx(DYNAMICS.time_constant_s, rel=1e-6)
    assert dynamics.mode_frequencies_rad_per_s == pytest.approx((2846.0, 4909.0), rel=1e-6)
    assert dynamics.damping_ratios == pytest.approx((0.6853, 0.082), rel=1e-6)
    assert dynamics.antiresonance_frequencies_rad_per_s == pytest.approx((3900.0,), rel=1e-6)
    assert dynamics.antiresonance_damping_ratios == pytest.approx((0.1,), rel=1e-6)
    assert (gain, delay_s) == (pytest.approx(1.0, rel=1e-6), 0.0)


@settings(max_examples=20, deadline=None)
@given(st.floats(1e-4, 1e-2), st.floats(500.0, 20000.0), st.floats(0.01, 3.0),
       st.floats(0.1, 10.0))
def test_any_damping_and_gain_keep_the_response(time_constant_s, frequency, damping, gain):
    given_part = ElectricVibrationDynamics(time_constant_s, (frequency,), (damping,))
    creep, dynamics, found, _ = from_control(gain * given_part.state_space())
    frequency_hz = np.geomspace(1.0, 1e4, 15)
    response = found * creep.response(frequency_hz) * dynamics.response(frequency_hz)
    np.testing.assert_allclose(response, gain * given_part.response(frequency_hz), rtol=1e-5)


def test_transfer_function_of_the_user_becomes_a_model():
    s = control.tf("s")
    creep, dynamics, gain, _ = from_control(3.0 * (s + 2.0) / (s + 1.0) / (0.001 * s + 1.0))
    assert creep.poles_rad_per_s == pytest.approx([1.0])
    assert creep.zeros_rad_per_s == pytest.approx([2.0])
    assert dynamics.time_constant_s == pytest.approx(0.001)
    assert gain == pytest.approx(3.0)


def test_sampled_system_answers_as_the_model_at_the_sample_instants():
    system = to_control(model(), 25e-6)
    assert system.dt == 25e-6
    assert (system.input_labels, system.output_labels) == (["hysteresis_um"], ["displacement_um"])
    step = control.step_response(to_control(model()), 25e-6 * np.arange(40)).outputs
    np.testing.assert_allclose(
        control.step_response(system, 25e-6 * np.arange(40)).outputs, step, atol=1e-9)


@pytest.mark.parametrize(("system", "reason"), [
    (control.tf([1.0], [1.0, -1.0]), "a pole at 1"),
    (control.tf([1.0, -5.0], [1.0, 3.0, 2.0]), "a zero at 5"),
    (control.tf([1.0], [1.0, 0.5], 0.1), "is discrete"),
    (control.tf([1.0, 1.0], [1.0, 2.0, 2.0]), "1 real zeros and 0 real poles"),
    (control.ss(-np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2))), "2 inputs"),
])
def test_system_that_no_model_holds_is_refused(system, reason):
    with pytest.raises(ValueError, match=reason):
        from_control(system)


def test_lag_of_the_amplifier_is_in_the_system_and_what_is_not_linear_is_named():
    lagging = replace(model(), effects=(AmplifierLag(1e-4),))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        system = lagging.to_control()
    frequency_hz = np.array([1.0, 300.0, 2000.0])
    s = 2j * np.pi * frequency_hz
    np.testing.assert_allclose(
        system(s), lagging.response(frequency_hz) / (1.0 + 1e-4 * s), rtol=1e-9)
    with pytest.warns(LeftOut, match="not part of the linear system: voltage_clipping"):
        replace(lagging, effects=(*lagging.effects, VoltageClipping(0.0, 100.0))).to_control()


def test_model_takes_a_linear_part_back():
    lagging = replace(model(), effects=(AmplifierLag(1e-4),))
    with pytest.warns(LeftOut, match="amplifier_lag"):
        system = to_control(lagging, lags=False)
    back = with_linear_part(lagging, 2.0 * system)
    assert back.effects == lagging.effects
    assert back.dynamics.time_constant_s == pytest.approx(DYNAMICS.time_constant_s, rel=1e-6)
    assert back.hysteresis.density_um_per_v2 == pytest.approx(np.array([[0.02]]), rel=1e-6)


@pytest.mark.parametrize("delay_s", [1e-6, 40e-6, 3e-3])
def test_delay_comes_back_from_its_approximation(delay_s):
    late = replace(model(), effects=(Delay(delay_s),))
    parts = from_control(to_control(late))
    assert parts.delay_s == pytest.approx(delay_s, rel=1e-6)
    assert parts.creep.poles_rad_per_s == pytest.approx(CREEP.poles_rad_per_s, rel=1e-6)
    assert parts.dynamics.mode_frequencies_rad_per_s == pytest.approx((2846.0, 4909.0), rel=1e-6)
    back = with_linear_part(late, to_control(late))
    assert [type(effect) for effect in back.effects] == [Delay]
    frequency_hz = np.geomspace(1.0, 1e4, 15)
    np.testing.assert_allclose(
        back.response(frequency_hz), late.response(frequency_hz), rtol=1e-5)


def test_all_pass_that_is_no_delay_is_refused():
    with pytest.raises(ValueError, match="a zero at 5"):
        from_control(control.tf([1.0, -12.0, 35.0], [1.0, 12.0, 35.0]))


def test_matlab_gets_the_system_and_the_hysteresis(tmp_path):
    model().to_matlab(tmp_path / "model.mat")
    read = scipy.io.loadmat(tmp_path / "model.mat")
    system = control.ss(*(read[name] for name in "ABCD"))
    assert system.dcgain() == pytest.approx(to_control(model()).dcgain())
    assert read["hysteresis"]["voltage_max_v"].item().item() == 120.0
