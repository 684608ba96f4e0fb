# SPDX-License-Identifier: BSD-3-Clause
import re

import numpy as np
import pytest

from piezo_controller.feedforward.approach import StageClock
from piezo_controller.feedforward.feasibility import UnreachableReference
from piezo_controller.feedforward.periodic import BANDWIDTH_HZ, bandwidth_hz, plan_feedforward
from piezo_controller.references.reference import Reference, sample_reference
from piezo_controller.references.smooth_rise import minimum_jerk
from piezo_models.cascade import StageModel
from piezo_models.linear.dynamics import CreepDynamics

pytestmark = pytest.mark.kernels

SAMPLE_PERIOD_S = 25e-6
TRAJECTORIES = [(40.0, 40.0), (100.0, 40.0), (500.0, 21.0), (1000.0, 9.0)]


def harmonic(frequency_hz, amplitude_um, centre_um=50.0):
    return sample_reference(Reference("harmonic", (frequency_hz,), (amplitude_um,), (), centre_um))


@pytest.fixture(scope="module")
def model_without_creep(stage_model):
    return StageModel(stage_model.hysteresis, CreepDynamics((), ()), stage_model.dynamics)


@pytest.mark.parametrize("frequency_hz, amplitude_um", TRAJECTORIES)
def test_model_follows_the_reference_exactly(model_without_creep, frequency_hz, amplitude_um):
    plan = plan_feedforward(harmonic(frequency_hz, amplitude_um), model_without_creep)
    begin = len(plan.once_voltage_v)
    voltage_v = plan.voltage_v(0, begin + 8000)
    error_um = (model_without_creep.simulate(voltage_v, SAMPLE_PERIOD_S)
                - plan.expected_um(0, begin + 8000))
    assert np.sqrt(np.mean(error_um[begin:] ** 2)) < 1e-6 * amplitude_um
    assert np.abs(error_um[:begin]).max() < 1e-6 * amplitude_um


@pytest.mark.parametrize("frequency_hz, amplitude_um", TRAJECTORIES)
def test_with_creep_only_its_slow_drift_remains_and_the_mean_is_met(stage_model, frequency_hz,
                                                                     amplitude_um):
    reference_um = harmonic(frequency_hz, amplitude_um)
    plan = plan_feedforward(reference_um, stage_model, duration_s=1.0)
    begin = len(plan.once_voltage_v)
    displacement_um = stage_model.simulate(plan.voltage_v(0, begin + 40000), SAMPLE_PERIOD_S)
    error_um = displacement_um[begin:] - plan.expected_um(begin, 40000)
    assert abs(error_um.mean()) < 1e-4
    periods_um = error_um.reshape(-1, len(reference_um))
    last_um = periods_um[-1] - np.linspace(-0.5, 0.5, len(reference_um)) * (
        periods_um[-1].mean() - periods_um[-2].mean()) - periods_um[-1].mean()
    assert np.sqrt(np.mean(last_um**2)) < 1e-4 * amplitude_um


@pytest.mark.parametrize("mode", ["feedforward", "open_loop"])
@pytest.mark.parametrize("frequency_hz, amplitude_um", [*TRAJECTORIES, (1500.0, 0.5), (2.0, 40.0)])
def test_voltage_wipes_the_memory_and_is_continuous_within_the_limits(stage_model, mode,
                                                                      frequency_hz, amplitude_um):
    plan = plan_feedforward(harmonic(frequency_hz, amplitude_um), stage_model, mode)
    begin, period = len(plan.once_voltage_v), len(plan.period_voltage_v)
    voltage_v = plan.voltage_v(0, begin + 2 * period)
    assert voltage_v[0] == 0.0
    assert voltage_v[:plan.feedback_start_sample].min() == voltage_v.min() == -20.0
    assert voltage_v.max() <= 120.0
    # Seams are no rougher than the period itself, whose turning points are the steepest places.
    steps_v = np.abs(np.diff(voltage_v))
    roughest_v = np.abs(np.diff(plan.period_voltage_v)).max() + 0.2
    assert steps_v.max() <= roughest_v
    assert steps_v.max() <= 2e6 * SAMPLE_PERIOD_S
    assert begin % 40 == plan.feedback_start_sample % 40 == 0


def test_repeated_period_is_the_models_own_steady_state(stage_model):
    plan = plan_feedforward(harmonic(100.0, 40.0), stage_model)
    begin = len(plan.once_voltage_v)
    hysteresis_um = stage_model.hysteresis.simulate(plan.voltage_v(0, begin + 1200))[begin:]
    np.testing.assert_allclose(hysteresis_um[400:800], hysteresis_um[:400], atol=1e-9)
    np.testing.assert_allclose(hysteresis_um[800:], hysteresis_um[:400], atol=1e-9)


def test_expected_displacement_leads_over_to_the_reference_without_a_step(stage_model):
    plan = plan_feedforward(harmonic(500.0, 21.0), stage_model)
    begin = len(plan.once_voltage_v)
    expected_um = plan.expected_um(begin - 800, 1600)
    ideal_um = 50 + 10.5 * np.sin(2 * np.pi * 500 * np.arange(-800, 800) * SAMPLE_PERIOD_S)
    assert np.abs(expected_um - ideal_um).max() < 0.1


def test_open_loop_knows_the_gain_but_no_dynamics(stage_model):
    reference_um = harmonic(100.0, 20.0)
    plan = plan_feedforward(reference_um, stage_model, "open_loop")
    voltage_v = plan.period_voltage_v - plan.period_voltage_v.mean()
    gain = (reference_um - 50) @ voltage_v / (voltage_v @ voltage_v)
    low_um, high_um = stage_model.hysteresis.output_range_um
    assert gain == pytest.approx((high_um - low_um) / 140)
    np.testing.assert_allclose(gain * voltage_v, reference_um - 50, atol=1e-9)


@pytest.mark.parametrize("reference", [
    Reference("harmonic", (1000.0,), (40.0,), (), 50.0),
    Reference("harmonic", (500.0,), (21.0,), (), 5.0),
    Reference("triangle", (100.0,), (80.0,), (), 50.0),
    Reference("harmonic", (40.0,), (200.0,), (), 60.0),
])
def test_refused_reference_names_an_amplitude_that_is_accepted(stage_model, reference):
    period_um = sample_reference(reference)
    with pytest.raises(UnreachableReference) as refusal:
        plan_feedforward(period_um, stage_model)
    reachable_um = refusal.value.reachable_um
    assert f"{reachable_um:g} um peak to peak is within reach" in str(refusal.value)
    assert re.search(r"it takes .* V, available are -20 to 120 V", str(refusal.value))

    def scaled_to(amplitude_um):
        return period_um.mean() + (period_um - period_um.mean()) * amplitude_um / np.ptp(period_um)

    plan_feedforward(scaled_to(reachable_um), stage_model)
    with pytest.raises(UnreachableReference):
        plan_feedforward(scaled_to(1.02 * reachable_um), stage_model)


def test_slew_limit_refuses_and_names_an_amplitude_that_keeps_it(stage_model):
    slow = StageClock(slew_limit_v_per_s=5e4)
    with pytest.raises(UnreachableReference, match="slew limit") as refusal:
        plan_feedforward(harmonic(500.0, 21.0), stage_model, stage=slow)
    reachable_um = refusal.value.reachable_um
    assert 0 < reachable_um < 21
    plan = plan_feedforward(harmonic(500.0, reachable_um), stage_model, stage=slow)
    voltage_v = plan.voltage_v(0, len(plan.once_voltage_v) + 160)
    assert np.abs(np.diff(voltage_v)).max() <= 5e4 * SAMPLE_PERIOD_S


def test_mean_beyond_the_travel_is_refused_with_the_travel_named(stage_model):
    with pytest.raises(UnreachableReference, match="cannot hold the reference's mean") as refusal:
        plan_feedforward(harmonic(100.0, 1.0, 300.0), stage_model)
    assert refusal.value.reachable_um == 0.0


def test_model_that_begins_below_the_amplifier_is_refused(stage_model):
    with pytest.raises(ValueError, match="identify the model over the amplifier's range"):
        plan_feedforward(harmonic(100.0, 1.0), stage_model, stage=StageClock((0.0, 120.0)))


def test_content_above_the_bandwidth_is_left_out_instead_of_amplified(stage_model):
    reference_um = harmonic(100.0, 40.0)
    rounded_um = np.round(reference_um, 4)
    plan, exact = (plan_feedforward(r, stage_model) for r in (rounded_um, reference_um))
    assert np.abs(plan.period_voltage_v - exact.period_voltage_v).max() < 0.5


def test_minimum_jerk_starts_and_ends_without_speed():
    rise = minimum_jerk(1000)
    assert rise[0] == 0.0 and rise[-1] == pytest.approx(1, abs=1e-7)
    assert np.all(np.diff(rise) >= 0)
    assert np.abs(np.diff(rise, 2))[[0, -1]].max() < 0.05 * np.abs(np.diff(rise, 2)).max()


@pytest.mark.parametrize(("frequency_hz", "amplitude_um"), [(2000.0, 1.0), (3000.0, 40.0)])
def test_reference_out_of_reach_is_refused_at_any_frequency_and_what_is_named_instead_is_followed(
        model_without_creep, frequency_hz, amplitude_um):
    with pytest.raises(UnreachableReference) as refusal:
        plan_feedforward(harmonic(frequency_hz, amplitude_um), model_without_creep)
    reachable_um = refusal.value.reachable_um
    assert 0.0 < reachable_um < amplitude_um
    plan = plan_feedforward(harmonic(frequency_hz, reachable_um), model_without_creep)
    begin = len(plan.once_voltage_v)
    displacement_um = model_without_creep.simulate(
        plan.voltage_v(0, begin + 4000), SAMPLE_PERIOD_S)[begin:]
    error_um = displacement_um - plan.expected_um(begin, 4000)
    assert np.sqrt(np.mean(error_um**2)) < 1e-3 * reachable_um


def test_only_the_little_that_lies_beyond_the_bandwidth_is_left_out():
    time_s = np.arange(400) * SAMPLE_PERIOD_S
    slow_um, fast_um = (np.sin(2 * np.pi * hz * time_s) for hz in (100.0, 5000.0))
    # Of a sine of amplitude a the rms is a / sqrt(2), of the travel of about 2 um.
    assert bandwidth_hz(slow_um, SAMPLE_PERIOD_S) == BANDWIDTH_HZ
    assert bandwidth_hz(slow_um + 0.027 * fast_um, SAMPLE_PERIOD_S) == BANDWIDTH_HZ
    assert bandwidth_hz(slow_um + 0.030 * fast_um, SAMPLE_PERIOD_S) == 5000.0
    assert bandwidth_hz(np.full(400, 3.0), SAMPLE_PERIOD_S) == BANDWIDTH_HZ
