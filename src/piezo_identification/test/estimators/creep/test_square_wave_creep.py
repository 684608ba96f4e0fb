# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import replace

import numpy as np
import pytest

from piezo_identification.conditioning.waveforms import played
from piezo_identification.estimators.creep.square_wave_creep import estimate_creep
from piezo_identification.experiments import catalogue as experiments
from piezo_models.linear.dynamics import ElectricVibrationDynamics

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
    with pytest.raises(ValueError, match="lacks 20 samples from sample 40000"):
        played(replace(record(), gaps=[(40_000, 20)]))
