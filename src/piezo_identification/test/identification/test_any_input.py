# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from scipy.signal import chirp, lsim

from piezo_identification.estimators.dynamics.fast_estimate import estimate_dynamics
from piezo_identification.estimators.frequency_response.response_model import ResponseOrder
from piezo_identification.identification.estimated_loops import DensityOptions
from piezo_identification.identification.identify import identify
from piezo_identification.identification.linear_dynamics import is_square_wave
from piezo_models.linear.dynamics import CreepDynamics

PERIOD_S = 1e-4
LAG_S, MODE, DAMPING = 4e-4, 3000.0, 0.05
COUNT = 8_000


@pytest.fixture(scope="module")
def linear_stage(foreign_stage):
    return foreign_stage((), LAG_S, MODE, DAMPING, is_linear=True)


@pytest.fixture(scope="module")
def stage(foreign_stage):
    return foreign_stage((), LAG_S, MODE, DAMPING)


def voltage_of(kind):
    time_s = np.arange(COUNT) * PERIOD_S
    random = np.random.default_rng(4)
    if kind == "chirp":
        return 40.0 + 30.0 * chirp(time_s, 5.0, time_s[-1], 900.0)
    if kind == "multisine":
        phases = random.uniform(0.0, 2.0 * np.pi, 40)
        tones = 2.0 * np.pi * 20.0 * np.arange(1, 41)
        return 40.0 + 4.0 * np.sin(np.outer(time_s, tones) + phases).sum(axis=1)
    if kind == "noise":
        return np.clip(40.0 + 10.0 * random.normal(size=COUNT // 4), 0.0, 80.0).repeat(4)
    if kind == "steps":
        return np.resize(np.repeat([10.0, 60.0, 30.0, 75.0, 20.0, 50.0], COUNT // 6 + 1), COUNT)
    return np.where((np.arange(COUNT) * PERIOD_S / 0.030137) % 1.0 < 0.45, 65.0, 20.0)


def error_of(estimate):
    """Largest relative error of the response up to the mode and beyond."""
    frequency_hz = np.linspace(1.0, 900.0, 60)
    s = 2j * np.pi * frequency_hz
    truth = 1.0 / ((LAG_S * s + 1.0) * (s**2 / MODE**2 + 2 * DAMPING * s / MODE + 1.0))
    found = estimate.model.response(frequency_hz, [
        effect for effect in estimate.effects if effect.name == "vibration_mode"])
    found = found * np.exp(-s * estimate.delay_s)
    for effect in estimate.effects:
        if effect.name == "sensor_lag":
            found = found / (effect.time_constant_s * s + 1.0)
    return np.abs(found - truth).max() / np.abs(truth).max()


KINDS = ("square", "chirp", "multisine", "noise", "steps")


@pytest.mark.long  # the hysteresis below makes it harder
@pytest.mark.parametrize("kind", KINDS)
def test_dynamics_of_a_linear_stage_are_found_from_any_input(kind, linear_stage, record):
    recording = record(linear_stage, voltage_of(kind), PERIOD_S, noise_um=0.01)
    estimate = estimate_dynamics([recording], CreepDynamics())
    assert error_of(estimate) < 5e-3


@pytest.mark.long  # noise alone is asked for in test_unrecorded_hysteresis.py
@pytest.mark.parametrize("kind", KINDS)
def test_dynamics_are_found_behind_a_hysteresis_that_nothing_else_tells(kind, stage, record):
    recording = record(stage, voltage_of(kind), PERIOD_S, noise_um=0.01)
    estimate = estimate_dynamics([recording], CreepDynamics())
    # With the voltage taken for what enters the dynamics, noise would leave 0.18.
    assert error_of(estimate) < (5e-3 if kind == "chirp" else 0.03)


@pytest.mark.long
def test_edges_of_a_generator_between_the_samples_are_found(record, linear_stage):
    fine = 16
    time_s = np.arange(COUNT * fine) * PERIOD_S / fine
    # A period of 301.44 samples, whose edges the fine grid does not move.
    voltage_v = np.where(np.arange(COUNT * fine) % 4823 < 2170, 65.0, 20.0)
    response = lsim(([1.0], np.polymul([LAG_S, 1.0], [MODE**-2, 2 * DAMPING / MODE, 1.0])),
                    voltage_v, time_s, interp=False)[1]
    recording = record(linear_stage, voltage_v[::fine], PERIOD_S)
    noise_um = np.random.default_rng(2).normal(scale=0.01, size=COUNT)
    object.__setattr__(recording, "displacement_um", 0.5 * response[::fine] + noise_um)
    assert error_of(estimate_dynamics([recording], CreepDynamics())) < 5e-3
    # With the edges as sampled, 40 times the noise would be left.
    assert identify(dynamics=recording).adequacy["dynamics"]["ratio"] < 1.1


@pytest.mark.long
def test_a_linear_stage_becomes_a_line_with_its_gain(linear_stage, record):
    recording = record(linear_stage, voltage_of("square"), PERIOD_S, noise_um=0.01)
    hysteresis = identify(dynamics=recording, order=ResponseOrder(0, 1, 0)).model.hysteresis
    span_v = hysteresis.voltage_max_v - hysteresis.voltage_min_v
    gain = np.ptp(hysteresis.output_range_um) / span_v
    assert not hysteresis.density_um_per_v2.any()
    assert gain == pytest.approx(0.57, rel=3e-3)


@pytest.mark.long  # the deviation of a delay has tests of its own
def test_a_delay_beside_another_form_of_stage_has_a_deviation_that_agrees_with_its_verdict(
        record, linear_stage):
    """No linear fit has the stiffening, whose periodic residual hides delay and lag alike."""
    fine = 4
    time_s = np.arange(COUNT * fine) * PERIOD_S / fine
    voltage_v = voltage_of("multisine")
    response = lsim(([1.0], [MODE**-2, 2 * 0.02 / MODE, 1.0]),
                    np.repeat(voltage_v - 40.0, fine), time_s, interp=False)[1]
    half_a_sample_late = response[fine // 2 :: fine]
    recording = record(linear_stage, voltage_v, PERIOD_S)
    object.__setattr__(recording, "displacement_um", half_a_sample_late - (
        0.06 / np.abs(response).max() ** 2 * half_a_sample_late**3))
    delay = estimate_dynamics([recording], CreepDynamics(), mode_count=1).delay
    assert delay.is_significant
    assert abs(delay.delay_s + 0.5 * PERIOD_S) < 3.0 * delay.standard_deviation_s < 0.05 * PERIOD_S


def test_square_wave_whose_first_row_lies_between_its_levels_is_one(linear_stage, record):
    voltage_v = voltage_of("square")
    voltage_v[0] = 42.5
    assert is_square_wave(record(linear_stage, voltage_v, PERIOD_S, noise_um=0.01))


@pytest.mark.usefixtures("without_search")
def test_recordings_of_the_dynamics_may_differ_in_their_sample_periods(record, linear_stage):
    recordings = [record(linear_stage, voltage_of(kind)[: COUNT // 8], period_s, noise_um=0.01)
                  for kind, period_s in (("square", PERIOD_S), ("chirp", 2.0 * PERIOD_S))]
    adequacy = identify(dynamics=recordings, order=ResponseOrder(0, 1, 0),
                        density=DensityOptions(10, 1e-10, 1e-10)).adequacy
    assert {name: each["verdict"] for name, each in adequacy.items()} == {
        "dynamics": "adequate", "dynamics 2": "adequate"}
