# SPDX-License-Identifier: BSD-3-Clause
"""What is published waits in order, and is followed with bounded speed and acceleration."""

import numpy as np
import pytest

from piezo_controller.references.bounded_motion import BoundedMotion
from piezo_controller.references.kind import InvalidReference
from piezo_controller.references.live_reference import LiveReference
from piezo_controller.references.reference import Reference, trajectory

PERIOD_S = 25e-6


class Clock:
    time_s = 0.0

    def __call__(self):
        return self.time_s


def test_values_wait_in_order_and_come_once_however_they_are_cut_or_repeated():
    live, wanted_um = LiveReference(PERIOD_S), np.arange(100.0)
    assert not live.begun
    for first, last in ((0, 30), (10, 40), (20, 30), (40, 41), (41, 100)):
        live.take(first, 0.0, 0, wanted_um[first:last])
    assert live.begun and live.latest_um == 99.0
    np.testing.assert_array_equal(np.r_[live.give(7), live.give(1000)], wanted_um)
    assert live.give(5).size == 0


def test_slow_values_and_those_left_out_are_joined_by_straight_lines():
    live = LiveReference(PERIOD_S, offset_um=50.0)
    live.take(7, 4 * PERIOD_S, 0, [0.0, 4.0])
    live.take(11, 4 * PERIOD_S, 0, [12.0])  # 9 and 10 are lost
    np.testing.assert_allclose(
        live.give(100), 50.0 + np.r_[[0.0] * 4, 1:5, 4 + np.arange(1, 13) * 2 / 3])


def test_one_who_begins_anew_or_was_away_for_long_is_taken_from_there_on():
    live = LiveReference(PERIOD_S)
    live.take(500, 0.0, 0, [1.0])
    live.take(0, 0.0, 0, [2.0])
    live.take(100_000, 0.0, 0, [3.0])
    np.testing.assert_array_equal(live.give(100), [1.0, 2.0, 3.0])


def test_newest_are_kept_and_the_memory_is_bounded():
    live = LiveReference(PERIOD_S)
    for message in range(30):
        live.take(4000 * message, 0.0, 0, np.arange(4000.0) + 4000 * message)
    assert live.waiting_samples == 80_000
    live.keep_newest(3)
    np.testing.assert_array_equal(live.give(10), [119_997.0, 119_998.0, 119_999.0])


@pytest.mark.parametrize("centre_um", [np.nan, np.inf])
def test_a_centre_that_is_no_number_is_refused_before_anybody_is_waited_for(centre_um):
    with pytest.raises(InvalidReference, match="centre_um of the reference is not a finite"):
        LiveReference(25e-6, offset_um=centre_um)


def test_silence_begins_when_patience_ends():
    clock = Clock()
    live = LiveReference(PERIOD_S, patience_s=1.0, clock=clock)
    live.take(0, 0.0, 0, [1.0])
    clock.time_s = 0.9
    assert not live.silent
    clock.time_s = 1.0
    assert live.silent


@pytest.mark.parametrize(("message", "reason"), [
    ((0, 0.0, 0, []), "no or no finite displacements"),
    ((0, 0.0, 0, [1.0, np.nan]), "no or no finite displacements"),
    ((0, 3e-5, 0, [1.0]), "give a whole multiple of the sample clock's 2.5e-05 s"),
    ((0, -1.0, 0, [1.0]), "give a whole multiple"),
    ((1, 0.0, 5, [1.0]), "preview_samples of the reference is now 5, but was 0"),
])
def test_message_without_meaning_has_no_effect(message, reason):
    live = LiveReference(PERIOD_S)
    live.take(0, 0.0, 0, [4.0])
    with pytest.raises(InvalidReference, match=reason) as refusal:
        live.take(*message)
    assert "\n" not in str(refusal.value)
    assert live.latest_um == 4.0 and live.waiting_samples == 1


def test_what_keeps_to_its_band_and_amplitude_is_followed_exactly():
    reference = Reference("random", (100.0,), (10.0,), (), 50.0, seed=2)
    values_um = trajectory(reference).sample(0, 20000)
    motion = BoundedMotion(40.0, values_um[0], 100.0, 10.0, PERIOD_S)
    followed_um = motion.follow(values_um[:2000])
    far_samples = motion.far_samples
    # Ten time constants after the beginning nothing is left of the way from 40 um.
    np.testing.assert_allclose(motion.follow(values_um[2000:]), values_um[2000:], atol=1e-6)
    assert motion.far_samples == far_samples > 0
    assert abs(followed_um[0] - 40.0) < 0.02


def test_straight_lines_between_values_of_a_slow_publisher_count_as_followed():
    time_s = np.arange(20000) * PERIOD_S
    values_um = np.interp(time_s, time_s[::40], 5.0 * np.sin(100.0 * np.pi * time_s[::40]))
    motion = BoundedMotion(0.0, 0.0, 100.0, 10.0, PERIOD_S)
    motion.follow(values_um)
    assert motion.far_samples == 0


@pytest.mark.parametrize(("values_um", "far"), [
    (np.r_[np.zeros(10), np.full(4000, 10.0)], True),
    (np.r_[np.arange(400) * 0.05, np.full(4000, 20.0)], False),
    (np.random.default_rng(1).uniform(0.0, 10.0, 4000), True)])
def test_jumps_kinks_and_noise_are_followed_within_the_bounds(values_um, far):
    band_hz, amplitude_um = 100.0, 10.0
    motion = BoundedMotion(values_um[0], values_um[0], band_hz, amplitude_um, PERIOD_S)
    followed_um = np.r_[values_um[0], motion.follow(values_um)]
    speed_um_per_s = np.pi * band_hz * amplitude_um
    assert np.abs(np.diff(followed_um)).max() <= 2.01 * speed_um_per_s * PERIOD_S
    assert (motion.far_samples > 0) is far
    assert np.ptp(followed_um) <= 1.3 * np.ptp(values_um)
    settled_um = motion.follow(np.full(2000, values_um[-1]))
    assert settled_um[-1] == pytest.approx(values_um[-1], abs=1e-3)


@pytest.mark.parametrize("is_held", [False, True])
@pytest.mark.parametrize("seed", range(20))
def test_what_jumps_again_and_again_does_not_leave_the_declared_range(seed, is_held):
    """Values that are skipped make such jumps: the motion once left their range by a third."""
    rng = np.random.default_rng(seed)
    ends = np.cumsum(rng.choice([1, 10, 40, 120, 160, 200, 400], 60))
    levels_um = rng.uniform(45.0, 55.0, ends.size)
    sample = np.arange(ends[-1])
    values_um = levels_um[np.searchsorted(ends, sample, side="right")] if is_held else np.interp(
        sample, ends, levels_um)
    motion = BoundedMotion(values_um[0], values_um[0], 100.0, 10.0, PERIOD_S, (45.0, 55.0))
    followed_um = np.concatenate([motion.follow(part) for part in np.array_split(values_um, 7)])
    assert 44.99 < followed_um.min() and followed_um.max() < 55.01
    settled_um = motion.follow(np.full(4000, levels_um[-1]))
    assert settled_um[-1] == pytest.approx(levels_um[-1], abs=1e-3)


@pytest.mark.parametrize("start_um", [0.0, 47.0, 70.0])
def test_what_fills_its_range_is_followed_exactly_from_anywhere(start_um):
    values_um = 50.0 + 5.0 * np.sin(2.0 * np.pi * 100.0 * PERIOD_S * np.arange(8000))
    motion = BoundedMotion(start_um, values_um[0], 100.0, 10.0, PERIOD_S, (45.0, 55.0))
    followed_um = motion.follow(values_um)
    np.testing.assert_allclose(followed_um[4000:], values_um[4000:], atol=1e-3)
    if start_um == 47.0:
        assert 44.99 < followed_um.min() and followed_um.max() < 55.01
