# SPDX-License-Identifier: BSD-3-Clause
"""A model follows what was streamed to it, chunk by chunk."""

from dataclasses import replace

import numpy as np
import pytest

from piezo_controller.feedforward import plan_feedforward
from piezo_controller.preview_inverse import METHODS
from piezo_controller.reach import UnreachableReference
from piezo_controller.references import Reference, sample_trajectory
from piezo_controller.smooth_rise import smooth_rise
from piezo_controller.streamed_feedforward import join, lead_in_samples, plan_stream, stream_margin
from piezo_models.cascade import StageModel
from piezo_models.effects.sensor_lag import SensorLag
from piezo_models.effects.sensor_nonlinearity import SensorNonlinearity
from piezo_models.effects.slew_limit import SlewLimit
from piezo_models.linear import CreepDynamics, ElectricVibrationDynamics

pytestmark = pytest.mark.kernels

SAMPLE_PERIOD_S = 25e-6
RANDOM = Reference("random", (500.0,), (30.0,), (), 50.0, seed=3)
SAMPLES = 8000


def trajectory(reference, model, samples=SAMPLES):
    return sample_trajectory(reference, samples + stream_margin(model), lead_in_samples())


def streamed_error_um(plan, plant):
    """Error of a plant under a whole stream, from the reference's beginning on."""
    voltage_v = np.concatenate([plan.once_voltage_v, *plan.chunks()])
    error_um = (plan.expected_um(0, voltage_v.size)
                - plant.simulate(voltage_v, SAMPLE_PERIOD_S))
    return error_um[plan.begin_sample:]


def rms(values):
    return np.sqrt(np.mean(values**2))


@pytest.mark.parametrize(("method", "largest_percent"), [
    ("least_squares", 0.005), ("zero_phase", 0.001), ("derivatives", 0.05)])
@pytest.mark.parametrize("reference", [
    RANDOM, Reference("harmonic", (0.01,), (40.0,), (), 50.0),
    Reference("harmonic", (200.0,), (30.0,), (), 50.0)])
def test_model_with_creep_follows_any_reference(stage_model, reference, method, largest_percent):
    plan = plan_stream(trajectory(reference, stage_model), stage_model, method)
    error_um = streamed_error_um(plan, stage_model)
    assert error_um.size in (SAMPLES, SAMPLES + 1)
    assert 100 * rms(error_um) / 30.0 < largest_percent


@pytest.mark.parametrize("method", METHODS)
def test_voltage_does_not_depend_on_how_it_is_cut_into_chunks(stage_model, method):
    plan = plan_stream(trajectory(RANDOM, stage_model, 2000), stage_model, method)
    whole_v = np.concatenate(list(plan.chunks(100_000)))
    np.testing.assert_allclose(np.concatenate(list(plan.chunks(333))), whole_v, atol=1e-8)


def test_chunk_needs_no_more_than_the_preview(stage_model):
    wanted_um = trajectory(RANDOM, stage_model, 2000)
    other_um = wanted_um.copy()
    end = lead_in_samples() + 1000 + 20
    other_um[end:] += 5.0 * smooth_rise(np.arange(other_um.size - end) / 400)
    voltages_v = [np.concatenate(list(plan_stream(r, stage_model).chunks())) for r in
                  (wanted_um, other_um)]
    same = lead_in_samples() + 1000
    np.testing.assert_allclose(voltages_v[0][:same], voltages_v[1][:same], atol=1e-9)
    assert np.abs(voltages_v[0] - voltages_v[1])[same + 10:].max() > 0.1


def one_percent_wrong(model, seed):
    generator = np.random.default_rng(seed)

    def wrong(values):
        return tuple(np.asarray(values) * (1 + 0.01 * generator.choice([-1, 1], len(values))))

    dynamics = model.dynamics
    return StageModel(model.hysteresis, CreepDynamics(
        model.creep.poles_rad_per_s, model.creep.zeros_rad_per_s), ElectricVibrationDynamics(
            wrong([dynamics.time_constant_s])[0], wrong(dynamics.mode_frequencies_rad_per_s),
            wrong(dynamics.damping_ratios)))


@pytest.mark.parametrize("method", ["least_squares", "zero_phase"])
def test_twenty_samples_of_preview_are_as_good_as_the_whole_future_with_a_model_1_percent_wrong(
        stage_model, method):
    period_um = sample_trajectory(RANDOM, SAMPLES)
    for seed in range(3):
        wrong = one_percent_wrong(stage_model, seed)
        offline = plan_feedforward(period_um, wrong, duration_s=0.2)
        voltage_v = offline.voltage_v(0, offline.begin_sample + SAMPLES)
        offline_um = (stage_model.simulate(voltage_v, SAMPLE_PERIOD_S)
                      - offline.expected_um(0, voltage_v.size))[offline.begin_sample:]
        repeated_um = period_um[np.arange(-lead_in_samples(), SAMPLES + 20) % SAMPLES]
        online_um = streamed_error_um(plan_stream(repeated_um, wrong, method), stage_model)
        assert 0.05 < 100 * rms(offline_um) / 30.0
        assert rms(online_um) < 1.2 * rms(offline_um)


def test_effects_on_displacement_and_sensor_are_compensated_and_the_others_named(stage_model):
    effects = (SensorLag(2e-4), SensorNonlinearity(0.0, 0.5, 0.0, 0.0, 50.0, 50.0))
    model = replace(stage_model, effects=effects)
    plan = plan_stream(trajectory(RANDOM, model), model)
    assert plan.left_alone == ()
    limited = replace(stage_model, effects=(*effects, SlewLimit(1e6)))
    assert plan_stream(trajectory(RANDOM, limited), limited).left_alone == ("slew_limit",)
    assert 100 * rms(streamed_error_um(plan, model)) / 30.0 < 0.05
    blind = plan_stream(trajectory(RANDOM, stage_model), stage_model)
    assert 100 * rms(streamed_error_um(blind, model)) / 30.0 > 0.5


def test_reference_out_of_reach_is_refused_with_the_amplitude_within_reach(stage_model):
    reference = Reference("random", (900.0,), (90.0,), (), 50.0)
    with pytest.raises(UnreachableReference, match="is within reach") as refusal:
        plan_stream(trajectory(reference, stage_model, 4000), stage_model)
    assert 0.0 < refusal.value.reachable_um < 90.0
    with pytest.raises(UnreachableReference, match="cannot hold the reference's mean"):
        plan_stream(np.full(7000, 300.0), stage_model)


def test_voltage_does_not_jump_where_one_reference_follows_another(stage_model):
    fade = 2000
    kinds = [Reference("harmonic", (100.0,), (40.0,), (), 50.0),
             Reference("raster", (100.0,), (20.0,), (), 65.0),
             Reference("random", (300.0,), (30.0,), (), 40.0),
             Reference("triangle", (50.0,), (20.0,), (1.0,), 57.0)]
    margin = stream_margin(stage_model)
    stretches = [sample_trajectory(kind, 4000 + (margin if n == 3 else fade),
                                   lead_in_samples() if n == 0 else fade)
                 for n, kind in enumerate(kinds)]
    plan = plan_stream(join(stretches, fade), stage_model)
    voltage_v = np.concatenate([plan.once_voltage_v, *plan.chunks()])
    alone_v = []
    for kind in kinds:
        single = plan_stream(trajectory(kind, stage_model), stage_model)
        alone_v.append(np.abs(np.diff(np.concatenate(list(single.chunks())))).max())
    assert np.abs(np.diff(voltage_v)).max() < 1.3 * max(alone_v)
    assert 100 * rms(streamed_error_um(plan, stage_model)) / 40.0 < 0.01


def test_joined_trajectories_are_themselves_outside_the_transitions():
    first, second = np.sin(np.arange(600) / 20), 3.0 + np.cos(np.arange(700) / 30)
    joined = join([first, second], 100)
    assert joined.size == 1200
    np.testing.assert_array_equal(joined[:500], first[:500])
    np.testing.assert_array_equal(joined[600:], second[100:])
    assert np.abs(np.diff(joined)).max() < 0.15
