# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from piezo_identification.conditioning.settling import low_frequency_delay_s
from piezo_identification.conditioning.waveforms import played
from piezo_identification.estimators.creep.square_wave_creep import estimate_creep, left_out_s
from piezo_identification.estimators.estimate import creep_of_partial_fractions
from piezo_identification.experiments import catalogue as experiments
from piezo_models.linear.dynamics import ElectricVibrationDynamics
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag

CLOCK_HZ = 2000.0
FREQUENCY_HZ = np.geomspace(0.002, 10.0, 30)


@pytest.fixture(scope="module")
def record(play):
    def record(seed=0, **options):
        return play(experiments.creep(), seed, CLOCK_HZ, **options)
    return record


def response_error(estimate, truth):
    """Largest relative error but for a common gain, which the hysteresis takes up."""
    ratio = estimate.response(FREQUENCY_HZ) / truth.response(FREQUENCY_HZ)
    return np.abs(ratio / ratio[-1] - 1.0).max()


@pytest.mark.parametrize("seed", [
    1, *(pytest.param(seed, marks=pytest.mark.long) for seed in (2, 3))])
def test_creep_is_recovered_through_noise_and_hysteresis_offset(plant, record, seed):
    estimate = estimate_creep(record(seed), plant.dynamics).model
    assert response_error(estimate, plant.creep) < 1e-4
    assert len(estimate.poles_rad_per_s) == 4
    assert estimate.poles_rad_per_s[0] == pytest.approx(0.01419, rel=1e-3)
    assert estimate.zeros_rad_per_s[0] == pytest.approx(0.01458, rel=1e-3)
    assert estimate.poles_rad_per_s[3] == pytest.approx(17.57, rel=0.02)


@pytest.mark.kernels
def test_creep_left_from_before_does_not_disturb(plant, record):
    memory = plant.memory()
    plant.simulate(np.full(40_000, 120.0), 1e-3, memory)
    estimate = estimate_creep(record(4, memory=memory), plant.dynamics).model
    assert response_error(estimate, plant.creep) < 1e-4


def test_the_delay_of_the_fast_dynamics_matters_to_the_fast_pair(plant, record):
    recording = record(5, noise_um=0.0)
    ignored = estimate_creep(recording).model
    known = estimate_creep(recording, plant.dynamics).model
    assert response_error(known, plant.creep) < 0.2 * response_error(ignored, plant.creep)


def test_ringing_that_outlasts_the_usual_settling_is_not_taken_for_creep(plant, record):
    ringing = ElectricVibrationDynamics(0.00049, (2450.0, 3550.0), (0.012, 0.02))
    recording = record(6, stage=replace(plant, dynamics=ringing))
    estimate = estimate_creep(recording, ringing).model
    # The fastest pair is over before the ringing is.
    assert estimate.poles_rad_per_s == pytest.approx((0.01419, 0.1684, 1.053), rel=0.01)


def test_creep_of_a_fast_stage_is_sought_as_soon_as_its_fast_motion_is_over():
    fast = ElectricVibrationDynamics(1e-4, (1.2e4,), (0.2,))
    rates, gains = np.array([0.4, 70.0]), np.array([0.05, 0.05])
    period_s, time_s = 2.5e-3, 2.5e-3 * np.arange(16_000)
    half = time_s.size // 2
    level = np.repeat([1.0, 0.0], half)
    # In closed form: the lag that low frequencies see puts the creep off.
    later_s = np.maximum(time_s - 20.0 - low_frequency_delay_s(fast), 0.0)
    stepped = level + np.sum([
        gain * np.where(time_s >= 20.0, np.exp(-rate * later_s), 1.0)
        for rate, gain in zip(rates, gains, strict=True)], axis=0)
    noise_um = 0.004 * np.random.default_rng(8).normal(size=time_s.size)
    recording = Recording("closed form", 1.0 / period_s, np.arange(time_s.size),
                          np.full(time_s.size, period_s), 20.0 + 13.0 * level,
                          10.0 * stepped + noise_um,
                          np.full(time_s.size, Flag.PLAYING, dtype=np.uint32))
    expected = creep_of_partial_fractions(rates, gains)[0]
    found, as_usual = estimate_creep(recording, fast).model, estimate_creep(recording).model
    assert found.poles_rad_per_s == pytest.approx(expected.poles_rad_per_s, rel=0.05)
    assert response_error(found, expected) < 6e-4
    assert response_error(as_usual, expected) > 1e-3
    assert left_out_s(fast) < 0.2 * left_out_s(None)


def test_creep_alike_in_every_decade_is_followed_to_the_noise():
    rates = np.geomspace(1e-3, 10.0, 10)
    period_s, half = 0.2, 200
    level = np.tile(np.repeat([1.0, 0.0], half), 2)
    crept = sum(lfilter([0.0, 1.0 - decay], [1.0, -decay], level)
                for decay in np.exp(-rates * period_s))
    noise_um = 2e-3 * np.random.default_rng(3).normal(size=level.size)
    recording = Recording("every decade", 1.0 / period_s, np.arange(level.size),
                          np.full(level.size, period_s), 75.0 * level,
                          15.0 * (level + 0.012 * crept) + noise_um,
                          np.full(level.size, Flag.PLAYING, dtype=np.uint32))
    estimate = estimate_creep(recording)
    assert np.all(np.diff(estimate.model.zeros_rad_per_s) > 0.0)
    assert estimate.residual_rms < 1.1 * 2e-3


def test_fewer_pairs_can_be_asked_for(record):
    assert len(estimate_creep(record(), pair_count=2).model.poles_rad_per_s) == 2


def test_a_stage_without_creep_shows_none(record):
    recording = record()
    rng = np.random.default_rng(6)
    clean_um = recording.voltage_v + 1e-3 * rng.normal(size=recording.voltage_v.size)
    assert estimate_creep(replace(recording, displacement_um=clean_um)).model.poles_rad_per_s == ()


def test_a_recording_that_is_no_square_wave_is_refused(record):
    recording = record()
    wave_v = np.sin(np.arange(recording.voltage_v.size))
    with pytest.raises(ValueError, match="creep is no square wave"):
        estimate_creep(replace(recording, voltage_v=wave_v))


def test_a_square_wave_too_fast_for_creep_is_refused(play):
    with pytest.raises(ValueError, match="dynamics steps faster"):
        estimate_creep(play(experiments.dynamics(duration_s=0.2)))


def test_missing_samples_are_refused_with_their_place(record):
    with pytest.raises(ValueError, match="gap of 20 samples at sample 40000"):
        played(replace(record(), gaps=[(40_000, 20)]))
