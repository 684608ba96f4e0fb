# SPDX-License-Identifier: BSD-3-Clause
"""A stage follows what is published while it plays, late by a constant time."""

import numpy as np
import pytest

from piezo_controller.feedforward.approach import StageClock
from piezo_controller.feedforward.feasibility import UnreachableReference
from piezo_controller.feedforward.live import DELAY_SAMPLES, plan_live
from piezo_controller.feedforward.preview_inverse import short_preview_inverse
from piezo_controller.references.kind import InvalidReference
from piezo_controller.references.live_reference import LiveReference
from piezo_controller.references.reference import Reference, trajectory
from piezo_models.linear.dynamics import zoh_response

PERIOD_S = 25e-6
TICK = 40
BAND_HZ, AMPLITUDE_UM = 100.0, 10.0
RANDOM = Reference("random", (BAND_HZ,), (AMPLITUDE_UM,), (), 50.0, seed=4)
RUN_SAMPLES = 8000


class Publisher:
    """Publishes a reference at the pace of the stage."""

    def __init__(self, preview_samples=0, reference=RANDOM, wanted=None):
        self.live = LiveReference(PERIOD_S)
        self.preview_samples, self.sent = preview_samples, 0
        self._wanted = wanted or trajectory(reference).sample
        self.publish(TICK)

    def publish(self, samples):
        self.live.take(self.sent, 0.0, self.preview_samples, self._wanted(self.sent, samples))
        self.sent += samples

    def skip(self, samples):
        self.sent += samples


def follow(model, publisher, run_samples=RUN_SAMPLES, publish=lambda publisher, tick:
           publisher.publish(TICK)):
    """Play a plan tick by tick on the model itself; return plan, voltages and expected."""
    plan = plan_live(publisher.live, BAND_HZ, AMPLITUDE_UM, run_samples, model)
    more, loaded_v, played_v, expected_um = plan.continuation(), plan.once_voltage_v, [], []
    for tick in range((plan.begin_sample + run_samples) // TICK):
        while (chunk_v := more()) is not None and chunk_v.size:
            loaded_v = np.r_[loaded_v, chunk_v]
        assert loaded_v.size >= (tick + 1) * TICK, "the stage ran dry"
        played_v.append(loaded_v[tick * TICK:(tick + 1) * TICK])
        expected_um.append(plan.expected_um(tick * TICK, TICK))
        plan.take(np.zeros(TICK))
        publish(publisher, tick)
    assert more().size == 0
    return plan, np.concatenate(played_v), np.concatenate(expected_um)


def error_percent(model, plan, played_v, expected_um):
    error_um = (model.simulate(played_v, PERIOD_S) - expected_um)[plan.begin_sample:]
    return 100 * np.sqrt(np.mean(error_um**2)) / AMPLITUDE_UM


@pytest.mark.parametrize(("preview_samples", "largest_percent"), [(0, 0.5), (5, 0.4), (20, 0.01)])
def test_model_follows_what_is_published_however_little_is_known_ahead(
        stage_model, preview_samples, largest_percent):
    plan, *played = follow(stage_model, Publisher(preview_samples))
    assert error_percent(stage_model, plan, *played) < largest_percent
    assert plan.degraded == ""


def test_reference_is_followed_by_the_delay_that_is_told(stage_model):
    publisher = Publisher(20)
    sent_at = []
    plan, _, expected_um = follow(
        stage_model, publisher,
        publish=lambda publisher, tick: (sent_at.append(publisher.sent), publisher.publish(TICK)))
    # The last value lies 20 samples ahead of the publisher's present.
    begin = plan.begin_sample + 2000
    published = sent_at[begin // TICK] - 20
    wanted_um = trajectory(RANDOM).sample(published - plan.delay_samples, 4000)
    np.testing.assert_allclose(expected_um[begin:begin + 4000], wanted_um, atol=1e-4)
    assert plan.delay_samples <= DELAY_SAMPLES + 2 * TICK + 20


def test_nothing_jumps_where_a_far_reference_begins(stage_model):
    def wanted(first, count):
        return np.where(np.arange(first, first + count) < 5 * TICK, 30.0, 60.0)

    plan, played_v, expected_um = follow(stage_model, Publisher(wanted=wanted))
    assert np.abs(np.diff(expected_um)).max() < 2.1 * np.pi * BAND_HZ * AMPLITUDE_UM * PERIOD_S
    assert expected_um[-1] == pytest.approx(60.0, abs=1e-3)


def test_publisher_that_falls_silent_is_held_and_taken_up_again(stage_model):
    def publish(publisher, tick):
        publisher.skip(TICK) if 400 <= tick < 480 else publisher.publish(TICK)

    plan, played_v, expected_um = follow(stage_model, Publisher(20), 16000, publish)
    # 80 ms of silence, of which what was loaded ahead bridges up to 22 ms.
    assert 80 * TICK - 900 <= plan.held_samples <= 80 * TICK
    assert "held, as nothing was published" in plan.degraded
    assert np.abs(np.diff(expected_um)).max() < 2.1 * np.pi * BAND_HZ * AMPLITUDE_UM * PERIOD_S
    assert np.ptp(expected_um[17600:18800]) < 1e-3
    assert np.ptp(expected_um[-2000:]) > 1.0
    assert error_percent(stage_model, plan, played_v, expected_um) < 0.5


def test_publisher_that_is_faster_than_the_stage_is_followed_with_values_left_out(stage_model):
    plan, played_v, expected_um = follow(
        stage_model, Publisher(20), 16000, lambda publisher, tick: publisher.publish(60))
    assert plan.skipped > 0 and "skipped" in plan.degraded
    assert np.abs(np.diff(expected_um)).max() < 2.1 * np.pi * BAND_HZ * AMPLITUDE_UM * PERIOD_S


def test_reference_beyond_the_range_is_clipped_to_it(stage_model):
    high_um = plan_live(Publisher().live, BAND_HZ, AMPLITUDE_UM, 400, stage_model).range_um[1]
    publisher = Publisher(wanted=lambda first, count: high_um - 4.0 + np.where(
        np.arange(first, first + count) < 8000, 0.0, 8.0))
    plan, played_v, expected_um = follow(stage_model, publisher, 12000)
    assert plan.clipped_samples > 0
    assert f"clipped to {plan.range_um[0]:.4g} to {high_um:.4g} um" in plan.degraded
    assert expected_um[-1] == pytest.approx(high_um, abs=1e-3)
    assert -20.0 <= played_v.min() and played_v.max() <= 120.0
    assert stage_model.simulate(played_v, PERIOD_S)[-1] == pytest.approx(high_um, abs=0.2)


@pytest.mark.parametrize("beyond_um", [300.0, -300.0, 1e308])
@pytest.mark.parametrize("centre_um", [50.0, 0.0])
def test_reference_beyond_what_it_declared_ends_the_run(stage_model, beyond_um, centre_um):
    def wanted(first, count):
        return np.where(np.arange(first, first + count) < 20_000, 50.0, beyond_um)

    publisher = Publisher(wanted=wanted)
    plan = plan_live(publisher.live, BAND_HZ, AMPLITUDE_UM, 20_000, stage_model,
                     centre_um=centre_um)
    more = plan.continuation()
    with pytest.raises(InvalidReference, match="beyond its declared 10 um") as ended:
        for _ in range(plan.begin_sample // TICK + 500):
            more()
            plan.take(np.zeros(TICK))
            publisher.publish(TICK)
    assert plan.degraded == str(ended.value)
    # Nothing of it is loaded: the last value that was is one that was declared.
    assert plan.expected_um(0, 10**6)[-1] == pytest.approx(50.0, abs=1e-3)


def test_first_value_beyond_the_declared_centre_is_refused(stage_model):
    with pytest.raises(InvalidReference, match="10 um about 30 um: publish less"):
        plan_live(Publisher().live, BAND_HZ, AMPLITUDE_UM, 400, stage_model, centre_um=30.0)


@pytest.mark.parametrize("values_um", [np.full(TICK, np.nan), None])
def test_values_that_do_not_come_are_told_where_others_follow(stage_model, values_um):
    def publish(publisher, tick):
        if tick != 250:
            publisher.publish(TICK)
            return
        if values_um is not None:
            with pytest.raises(InvalidReference, match="no finite"):
                publisher.live.take(publisher.sent, 0.0, publisher.preview_samples, values_um)
        publisher.skip(TICK)

    plan, *_ = follow(stage_model, Publisher(20), publish=publish)
    assert "1 ms it was a straight line, as values were skipped" in plan.degraded


def test_lower_amplifier_reaches_less(stage_model):
    wide, narrow = (plan_live(Publisher().live, BAND_HZ, AMPLITUDE_UM, 400, stage_model,
                              stage=StageClock((-20.0, highest_v))).range_um[1]
                    for highest_v in (120.0, 60.0))
    assert narrow < wide - 20.0


def test_too_little_preview_for_the_band_is_refused_in_one_sentence(stage_model):
    with pytest.raises(ValueError, match="declare a lower frequency, or publish 20 samples") as no:
        plan_live(Publisher().live, 1500.0, 1.0, 400, stage_model)
    assert "\n" not in str(no.value)


def test_short_inverse_is_the_better_the_more_is_known_and_exact_at_rest(stage_model):
    system = stage_model.dynamics.state_space(())
    frequency_hz = np.linspace(0.0, BAND_HZ, 50)
    left = [np.abs(1 - short_preview_inverse(system, PERIOD_S, preview, BAND_HZ).response(
        frequency_hz, PERIOD_S) * zoh_response(system, frequency_hz, PERIOD_S))
        for preview in (0, 5, 20)]
    assert left[0].max() > left[1].max() > left[2].max()
    assert left[0].max() < 0.02
    assert [errors[0] for errors in left] == pytest.approx([0.0] * 3, abs=1e-9)


def test_first_value_out_of_reach_is_taken_as_the_nearest_within(stage_model):
    publisher = Publisher(wanted=lambda first, count: np.full(count, -300.0))
    plan = plan_live(publisher.live, BAND_HZ, AMPLITUDE_UM, 400, stage_model)
    assert plan.expected_um(plan.feedback_start_sample - 1, 1)[0] == pytest.approx(
        plan.range_um[0], abs=0.5)
    with pytest.raises(ValueError, match="the model begins at -20 V, the amplifier at 0 V"):
        plan_live(publisher.live, BAND_HZ, AMPLITUDE_UM, 400, stage_model,
                  stage=StageClock((0.0, 120.0)))
    assert issubclass(UnreachableReference, ValueError)
