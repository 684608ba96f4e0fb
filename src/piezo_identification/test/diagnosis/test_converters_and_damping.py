# SPDX-License-Identifier: BSD-3-Clause
"""Converter steps and damping that grows with the amplitude, in recordings that SciPy has made."""

import numpy as np
import pytest
from made_by_scipy import behind_mode, line_model, logged
from scipy.integrate import solve_ivp

from piezo_identification.diagnosis.diagnose import diagnose
from piezo_models.effects.amplitude_damping import AmplitudeDamping

pytestmark = pytest.mark.usefixtures("without_ceiling")

PERIOD_S = 1e-3
W, DAMPING = 400.0, 0.05


@pytest.fixture(scope="module")
def model():
    return line_model(W, DAMPING)


def slow(samples=6000):
    time_s = PERIOD_S * np.arange(samples)
    return 1.2 * np.sin(2.0 * np.pi * 0.11 * time_s) + 0.9 * np.sin(2.0 * np.pi * 0.31 * time_s)


def fast(samples=4000):
    noise = np.convolve(
        np.random.default_rng(1).normal(size=samples), np.hanning(9), mode="same")
    return 40.0 * noise / np.abs(noise).max() * np.repeat([0.15, 1.0, 0.4, 1.0], samples // 4)


def linear(voltage_v):
    return behind_mode(0.1 * (voltage_v - voltage_v[0]), W, DAMPING) + 0.1 * voltage_v[0]


def noise(size, deviation_um):
    return np.random.default_rng(9).normal(scale=deviation_um, size=size)


def damped(voltage_v, quadratic):
    """A mass with drag by the square of its speed, by an integrator with a step of its own."""
    def motion(t, state):
        held_v = voltage_v[min(int(t / PERIOD_S + 1e-9), voltage_v.size - 1)]
        x, speed = state
        drag = quadratic * abs(speed) * speed
        return speed, W * W * (0.1 * held_v - x) - 2.0 * DAMPING * W * speed - drag

    time_s = np.arange(voltage_v.size) * PERIOD_S
    return solve_ivp(motion, (0.0, time_s[-1]), (0.1 * voltage_v[0], 0.0), "RK45", time_s,
                     rtol=1e-7, atol=1e-9, max_step=PERIOD_S).y[0]


def test_steps_of_the_applied_voltage_are_found_with_their_size(model):
    voltage_v, step_v = slow(), 0.0571
    applied_v = step_v * np.round((voltage_v - 0.02) / step_v) + 0.02
    diagnosis = diagnose(model, [logged(
        voltage_v, linear(applied_v) + noise(voltage_v.size, 1e-4))])
    assert [entry["name"] for entry in diagnosis.effects] == ["voltage_steps"]
    found = diagnosis.effects[0]["parameters"]
    assert found["step_v"] == pytest.approx(step_v, rel=2e-3)
    assert found["share"] == pytest.approx(1.0, abs=0.15)
    assert diagnosis.after["rms_um"] < 0.5 * diagnosis.before["rms_um"]


def test_steps_of_the_sensor_are_found_with_their_size(model):
    voltage_v, step_um = slow(9000), 0.0031
    displacement_um = linear(voltage_v) + noise(voltage_v.size, 1e-4) + 3.0
    diagnosis = diagnose(model, [logged(
        voltage_v, step_um * np.round(displacement_um / step_um))])
    assert [entry["name"] for entry in diagnosis.effects] == ["sensor_steps"]
    assert diagnosis.effects[0]["parameters"]["step_um"] == pytest.approx(step_um, rel=1e-4)
    assert diagnosis.verdict == "explained"
    assert diagnosis.after["rms_um"] < 0.5 * diagnosis.before["rms_um"]


@pytest.mark.parametrize("deviation_um", [1e-3, pytest.param(1e-2, marks=pytest.mark.long)])
def test_steps_finer_than_the_noise_have_no_name(model, deviation_um):
    voltage_v, step_um = slow(), 1e-3
    displacement_um = linear(voltage_v) + noise(voltage_v.size, deviation_um)
    diagnosis = diagnose(model, [logged(
        voltage_v, step_um * np.round(displacement_um / step_um))])
    assert (diagnosis.verdict, diagnosis.effects) == ("none", [])


@pytest.mark.long
def test_damping_that_grows_with_the_amplitude_is_found(model):
    voltage_v, quadratic = fast(), 0.1
    displacement_um = damped(voltage_v, quadratic)
    diagnosis = diagnose(model, [logged(
        voltage_v, displacement_um + noise(voltage_v.size, 2e-3))])
    assert diagnosis.effects[0]["name"] == "amplitude_damping"
    found = diagnosis.effects[0]["parameters"]
    assert found["quadratic"] / found["half_range_um"] == pytest.approx(quadratic, rel=0.1)
    assert diagnosis.after["rms_um"] < 0.3 * diagnosis.before["rms_um"]


@pytest.mark.long
def test_the_equation_of_motion_is_solved():
    """Against an integrator: the load of the spring is the linear stage's displacement."""
    voltage_v = fast(2000)
    effect = AmplitudeDamping(0.0, 0.1 * 2.0, 2.0, W, DAMPING)
    found_um, truth_um = effect.apply(linear(voltage_v), PERIOD_S), damped(voltage_v, 0.1)
    left_um = linear(voltage_v) - truth_um
    assert np.std(found_um - truth_um) < 0.02 * np.std(left_um)
