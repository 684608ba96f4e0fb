# SPDX-License-Identifier: BSD-3-Clause
"""A model follows what was streamed to it, chunk by chunk."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from piezo_controller.feedforward.feasibility import UnreachableReference
from piezo_controller.feedforward.periodic import plan_feedforward
from piezo_controller.feedforward.preview_inverse import METHODS
from piezo_controller.feedforward.streamed import plan_stream
from piezo_controller.references.reference import Reference, trajectory
from piezo_controller.references.smooth_rise import smooth_rise
from piezo_controller.references.trajectory import FormulaTrajectory, JoinedTrajectory
from piezo_models.cascade import StageModel
from piezo_models.effects.sensor_lag import SensorLag
from piezo_models.effects.sensor_nonlinearity import SensorNonlinearity
from piezo_models.effects.slew_limit import SlewLimit
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics

pytestmark = pytest.mark.kernels

SAMPLE_PERIOD_S = 25e-6
RANDOM = Reference("random", (500.0,), (30.0,), (), 50.0, seed=3)
SAMPLES = 8000


def planned(reference, model, *options, samples=SAMPLES):
    return plan_stream(trajectory(reference), samples, model, *options)


def streamed_error_um(plan, plant):
    """Return the error of a plant under a whole stream, from the reference's beginning on."""
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
    plan = planned(reference, stage_model, method)
    error_um = streamed_error_um(plan, stage_model)
    assert error_um.size == SAMPLES
    assert 100 * rms(error_um) / 30.0 < largest_percent


@pytest.mark.parametrize("method", METHODS)
def test_voltage_does_not_depend_on_how_it_is_cut_into_chunks(stage_model, method):
    plan = planned(RANDOM, stage_model, method, samples=2000)
    whole_v = np.concatenate(list(plan.chunks(100_000)))
    np.testing.assert_allclose(np.concatenate(list(plan.chunks(333))), whole_v, atol=1e-8)


def test_chunk_needs_no_more_than_the_preview(stage_model):
    wanted = trajectory(RANDOM)
    end = 1000 + 20
    other = FormulaTrajectory(lambda at: wanted.sample(at[0], at.size)
                              + 5.0 * smooth_rise((at - end) / 400))
    plans = [plan_stream(one, 2000, stage_model) for one in (wanted, other)]
    voltages_v = [np.concatenate(list(plan.chunks())) for plan in plans]
    same = plans[0].begin_sample - plans[0].feedback_start_sample + 1000
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
    time = 2 * np.pi * np.arange(SAMPLES) / SAMPLES
    period_um = 50.0 + sum(np.sin(n * time + n**2) for n in range(5, 100, 3))
    for seed in range(3):
        wrong = one_percent_wrong(stage_model, seed)
        offline = plan_feedforward(period_um, wrong, duration_s=0.2)
        voltage_v = offline.voltage_v(0, offline.begin_sample + SAMPLES)
        offline_um = (stage_model.simulate(voltage_v, SAMPLE_PERIOD_S)
                      - offline.expected_um(0, voltage_v.size))[offline.begin_sample:]
        repeated = FormulaTrajectory(lambda at: period_um[at % SAMPLES])
        online_um = streamed_error_um(plan_stream(repeated, SAMPLES, wrong, method), stage_model)
        assert 0.05 < 100 * rms(offline_um) / 30.0
        assert rms(online_um) < 1.2 * rms(offline_um)


def test_effects_on_displacement_and_sensor_are_compensated_and_the_others_named(stage_model):
    effects = (SensorLag(2e-4), SensorNonlinearity(0.0, 0.5, 0.0, 0.0, 50.0, 50.0))
    model = replace(stage_model, effects=effects)
    plan = planned(RANDOM, model)
    assert plan.uncompensated == ()
    limited = replace(stage_model, effects=(*effects, SlewLimit(1e6)))
    assert planned(RANDOM, limited).uncompensated == ("slew_limit",)
    assert 100 * rms(streamed_error_um(plan, model)) / 30.0 < 0.05
    blind = planned(RANDOM, stage_model)
    assert 100 * rms(streamed_error_um(blind, model)) / 30.0 > 0.5


def test_infeasible_reference_is_refused_with_the_feasible_amplitude(stage_model):
    reference = Reference("random", (1500.0,), (90.0,), (), 50.0)
    with pytest.raises(UnreachableReference, match="is within reach") as refusal:
        planned(reference, stage_model, samples=4000)
    assert 0.0 < refusal.value.reachable_um < 90.0
    with pytest.raises(UnreachableReference, match="cannot hold the reference's mean"):
        plan_stream(FormulaTrajectory(lambda at: np.full(at.size, 300.0)), 4000, stage_model)


def test_voltage_does_not_jump_where_one_reference_follows_another(stage_model):
    fade = 2000
    kinds = [Reference("harmonic", (100.0,), (40.0,), (), 50.0),
             Reference("raster", (100.0,), (20.0,), (), 65.0),
             Reference("random", (300.0,), (30.0,), (), 40.0),
             Reference("triangle", (50.0,), (20.0,), (1.0,), 57.0)]
    joined = JoinedTrajectory([trajectory(kind) for kind in kinds], [4000] * 4, fade)
    plan = plan_stream(joined, 16_000, stage_model)
    voltage_v = np.concatenate([plan.once_voltage_v, *plan.chunks()])
    alone_v = []
    for kind in kinds:
        single = planned(kind, stage_model)
        alone_v.append(np.abs(np.diff(np.concatenate(list(single.chunks())))).max())
    assert np.abs(np.diff(voltage_v)).max() < 1.3 * max(alone_v)
    assert 100 * rms(streamed_error_um(plan, stage_model)) / 40.0 < 0.01


class Watched:
    """A slow sine of an hour that counts what is asked of it, and steps where it is told to."""

    def __init__(self, step_at=None):
        self.asked, self.furthest, self._step_at = 0, 0, step_at

    def trajectory(self):
        return FormulaTrajectory(self._formula)

    def _formula(self, at):
        self.asked += at.size
        self.furthest = max(self.furthest, at[-1])
        step = 0.0 if self._step_at is None else 30.0 * (at >= self._step_at)
        return 50.0 + 10.0 * np.sin(2 * np.pi * at * SAMPLE_PERIOD_S) + step


HOUR = 3600 * 40_000


def test_planning_an_hour_computes_no_more_than_the_part_that_is_checked(stage_model):
    watched, told = Watched(), []
    plan = plan_stream(watched.trajectory(), HOUR, stage_model, watch=told.append)
    assert watched.asked < 1.1 * 20.0 / SAMPLE_PERIOD_S
    assert told == sorted(told) and len(told) > 100 and told[-1] == 1.0
    # The travel was surveyed to its end.
    assert plan.travel_um(HOUR) == pytest.approx(20.0, rel=1e-3)
    assert watched.furthest > 0.999 * HOUR


def test_chunks_late_in_a_stream_keep_nothing_of_the_earlier_ones(stage_model):
    watched = Watched()
    plan = plan_stream(watched.trajectory(), HOUR, stage_model)
    chunks, asked, sizes = plan.chunks(), [], []
    tracemalloc.start()
    for _ in range(300):
        before = watched.asked
        next(chunks)
        asked.append(watched.asked - before)
        sizes.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert max(asked[2:]) <= 8000
    # A chunk that was kept would be 32 kB.
    assert max(sizes[100:]) < max(sizes[:100]) + 50_000


def test_what_is_out_of_reach_later_ends_the_stream_before_and_tells_when(stage_model):
    step_at = round(25.03 / SAMPLE_PERIOD_S)
    plan = plan_stream(Watched(step_at).trajectory(), HOUR, stage_model)
    played, chunks = plan.feedback_start_sample - plan.begin_sample, plan.chunks()
    with pytest.raises(UnreachableReference, match="between 24.95 and 25.05 s after its beginning"):
        for voltage_v in chunks:
            assert -20.0 <= voltage_v.min() and voltage_v.max() <= 120.0
            played += voltage_v.size
    assert step_at - 4000 - 20 <= played <= step_at


def test_extremes_far_ahead_are_looked_at_before_the_run(stage_model):
    with pytest.raises(UnreachableReference, match="it takes displacements from"):
        planned(Reference("harmonic", (0.002,), (400.0,), (), 50.0), stage_model, samples=HOUR)


class Ended(Exception):
    """What a cancelled goal raises."""


@pytest.mark.parametrize("amplitude_um", [
    pytest.param(30.0, marks=pytest.mark.long), 90.0])
def test_planning_can_be_cancelled_also_while_the_amplitude_within_reach_is_sought(
        stage_model, amplitude_um):
    watched = []

    def watch(fraction):
        watched.append(fraction)
        if len(watched) == 30:
            raise Ended

    reference = Reference("random", (1500.0,), (amplitude_um,), (), 50.0)
    with pytest.raises(Ended):
        plan_stream(trajectory(reference), HOUR, stage_model, watch=watch)


@pytest.mark.parametrize(("frequency_hz", "amplitude_um", "message"), [
    (3000.0, 40.0, "um peak to peak is within reach"),
    (5000.0, 0.01, "leaves an error of 26 % of this reference, as it moves too fast")])
def test_reference_that_is_too_fast_is_refused_in_place_of_being_left_out(
        stage_model, frequency_hz, amplitude_um, message):
    reference = Reference("harmonic", (frequency_hz,), (amplitude_um,), (), 50.0)
    with pytest.raises(UnreachableReference, match=message):
        planned(reference, stage_model)
