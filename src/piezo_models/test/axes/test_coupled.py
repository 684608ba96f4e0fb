# SPDX-License-Identifier: BSD-3-Clause
"""Modal models of several axes: response, simulation, python-control, softening."""

from dataclasses import replace

import control
import numpy as np
import pytest

from piezo_models.axes.coupled import CoupledModel, Softening

PERIOD_S = 1e-4


def model(**changes):
    poles = np.array([-30.0 + 2000.0j, -60.0 + 5200.0j, -8.0])
    rng = np.random.default_rng(3)
    residues = rng.normal(size=(3, 2, 2)) * 0.01 * np.array([-1j, -1j, 1.0])[:, None, None]
    fields = {"axes": ("x", "y"), "sample_period_s": PERIOD_S, "poles_rad_per_s": poles,
              "residues_um_per_v": residues, "direct_um_per_v": rng.normal(size=(2, 2, 2)) * 1e-3,
              "latency_samples": np.array([0, 3]), "operating_voltage_v": np.array([50.0, 40.0]),
              "operating_displacement_um": np.array([10.0, -4.0])} | changes
    return CoupledModel(**fields)


def softening(**changes):
    rng = np.random.default_rng(4)
    return Softening(**{
        "elongations": rng.normal(size=(2, 3, 2, 2)) * -1e-3j * np.array([1, 1, 0])[:, None, None],
        "gain": rng.normal(size=(2, 2, 2)) * 0.02, "reference_v": 2.0, "memory_s": 0.05,
        "range_v": (1.0, 3.0)} | changes)


def tones(samples=4096, amplitude_v=2.0):
    rng = np.random.default_rng(5)
    lines = np.exp(2j * np.pi * rng.random((samples // 2 - 1, 2)))
    drive = np.fft.irfft(np.concatenate([np.zeros((1, 2)), lines, np.zeros((1, 2))]), axis=0)
    return amplitude_v * drive / np.sqrt(np.mean(drive**2))


def test_simulation_of_a_periodic_voltage_is_the_response():
    of = model()
    drive = tones()
    frequency_hz = np.fft.rfftfreq(len(drive), PERIOD_S)
    spectrum = np.einsum("fij,fj->fi", of.response(frequency_hz), np.fft.rfft(drive, axis=0))
    wanted = np.fft.irfft(spectrum, axis=0) + of.operating_displacement_um
    found = of.simulate(drive + of.operating_voltage_v, periodic=True)
    np.testing.assert_allclose(found, wanted, atol=1e-5)


def test_a_stage_at_rest_stays_there():
    of = model(softening=softening())
    voltage_v = np.tile(of.operating_voltage_v + [1.0, -2.0], (500, 1))
    found = of.simulate(voltage_v)
    np.testing.assert_allclose(found, np.tile(found[:1], (500, 1)), atol=1e-9)


def test_softened_simulation_is_that_of_the_linear_model_at_its_amplitude():
    of = model(softening=softening(memory_s=20.0))
    drive = tones(amplitude_v=2.8)
    found = of.simulate(drive + of.operating_voltage_v, periodic=True)
    linear = of.at_amplitude(2.8).simulate(drive + of.operating_voltage_v, periodic=True)
    assert np.std(found - linear) < 1e-3 * np.std(linear)
    untouched = replace(of, softening=None).simulate(drive + of.operating_voltage_v, periodic=True)
    assert np.std(untouched - linear) > 0.01 * np.std(linear)


@pytest.mark.parametrize("amplitude_v", [None, 1.5])
def test_control_objects_have_the_same_response_and_come_back(amplitude_v):
    of = model(softening=softening())
    system = of.to_control(amplitude_v)
    frequency_hz = np.array([1.0, 100.0, 318.0, 1500.0, 4000.0])
    wanted = of.response(frequency_hz, amplitude_v)
    z = np.exp(2j * np.pi * frequency_hz * PERIOD_S)
    found = np.array([system(each) for each in z])
    np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-9)
    back = CoupledModel.from_control(system, ("x", "y"))
    np.testing.assert_allclose(back.response(frequency_hz), wanted, rtol=1e-5, atol=1e-8)
    assert system.input_labels == ["x_voltage_v", "y_voltage_v"]


def test_amplitudes_beyond_the_identification_are_held():
    of = softening()
    np.testing.assert_allclose(of.strengths(2.0), 0.0)
    np.testing.assert_allclose(of.strengths(99.0), [0.5, 0.25])


@pytest.mark.parametrize(("system", "words"), [
    (control.ss([[0.5]], [[1.0]], [[1.0]], [[0.0]], 1e-3), "1 inputs and 1 outputs"),
    (control.ss(-np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2))), "no sample period"),
    (control.ss(np.diag([0.5, 1.5]), np.eye(2), np.eye(2), np.zeros((2, 2)), 1e-3), "not stable"),
    (control.ss([[0.5, 1.0], [0.0, 0.5]], np.eye(2), np.eye(2), np.zeros((2, 2)), 1e-3),
     "modes differ"),
])
def test_other_systems_are_refused(system, words):
    with pytest.raises(ValueError, match=words):
        CoupledModel.from_control(system, ("x", "y"))


def test_parts_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="latency_samples has the shape"):
        model(latency_samples=np.zeros(3, dtype=int))
    with pytest.raises(ValueError, match="not stable"):
        model(poles_rad_per_s=np.array([30.0 + 2000.0j, -60.0 + 5200.0j, -8.0]))
    with pytest.raises(ValueError, match=r"give \(samples, 2\)"):
        model().simulate(np.zeros((5, 3)))
