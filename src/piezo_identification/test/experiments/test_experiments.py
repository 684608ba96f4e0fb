# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from piezo_identification.experiments import catalogue as experiments
from piezo_identification.experiments.catalogue import StageLimits, named_experiment

WAVEFORMS = (experiments.EXPERIMENTS | experiments.FURTHER_EXPERIMENTS).keys() - {"relay"}


@pytest.mark.parametrize("name", sorted(WAVEFORMS))
def test_every_named_experiment_stays_within_the_limits(name):
    experiment = named_experiment(name)
    limits = StageLimits()
    assert experiment.name == name
    assert experiment.voltage_v.min() >= limits.voltage_min_v
    assert experiment.voltage_v.max() <= limits.voltage_max_v
    steps_v = np.abs(np.diff(experiment.voltage_v))
    assert steps_v.max() * limits.sample_rate_hz <= limits.slew_limit_v_per_s
    held = experiment.sample_period_s * limits.sample_rate_hz
    assert held == pytest.approx(round(held))


def test_durations_count_repeats():
    assert named_experiment("creep").duration_s == pytest.approx(400.0)
    assert named_experiment("dynamics").duration_s == pytest.approx(2.0)
    assert experiments.creep(periods=2).duration_s == pytest.approx(800.0)


@pytest.mark.parametrize("name", ["creep", "dynamics"])
def test_square_waves_begin_at_the_upper_level_around_mid_range(name):
    voltage_v = named_experiment(name).voltage_v
    low_v, high_v = np.unique(voltage_v)
    assert voltage_v[0] == high_v
    assert 0.5 * (low_v + high_v) == pytest.approx(StageLimits().middle_v)
    assert np.count_nonzero(voltage_v == low_v) == voltage_v.size // 2


def test_hysteresis_harmonics_climb_the_levels_and_return_to_saturation():
    experiment = experiments.hysteresis(level_count=14)
    harmonics_v = experiment.voltage_v[:-1].reshape(14, 2000)
    assert np.all(harmonics_v[:, 0] == -20.0)
    assert experiment.voltage_v[-1] == -20.0
    np.testing.assert_allclose(harmonics_v.max(axis=1), -20.0 + 10.0 * np.arange(1, 15))
    # (4.6) at a quarter of the period is half of the amplitude.
    np.testing.assert_allclose(
        harmonics_v[:, 500], -20.0 + 5.0 * np.arange(1, 15), atol=1e-12
    )


def test_validation_begins_at_saturation_and_turns_off_the_levels():
    experiment = named_experiment("validation")
    assert experiment.voltage_v[0] == -20.0
    turns_v = -20.0 + 140.0 * np.array(experiments.VALIDATION_TURNS[1:-1])
    assert np.abs(turns_v / 2.0 - np.round(turns_v / 2.0)).min() > 0.01
    tones_v = experiment.voltage_v[-40_000:] - 50.0
    spectrum_v = 2.0 * np.abs(np.fft.rfft(tones_v)) / tones_v.size
    assert sorted(np.flatnonzero(spectrum_v > 0.1)) == [100, 300, 400, 500, 1000]


def test_the_multisine_climbs_from_saturation_to_six_tones_around_mid_range():
    voltage_v = named_experiment("multisine").voltage_v
    assert voltage_v[0] == -20.0
    tones_v = voltage_v[-40_000:]
    assert tones_v.mean() == pytest.approx(StageLimits().middle_v)
    spectrum_v = 2.0 * np.abs(np.fft.rfft(tones_v - tones_v.mean())) / tones_v.size
    assert list(np.flatnonzero(spectrum_v > 0.1)) == [100, 200, 300, 400, 500, 600]
    assert spectrum_v[200] == pytest.approx(2.0 * spectrum_v[100])


@pytest.mark.parametrize("make", [
    lambda: experiments.creep(swing_v=150.0),
    lambda: experiments.dynamics(StageLimits(-20.0, 20.0), swing_v=41.0),
])
def test_a_waveform_outside_the_range_is_refused(make):
    with pytest.raises(ValueError, match="the stage allows"):
        make()


def test_a_step_above_the_slew_limit_is_made_smaller():
    limits = StageLimits(slew_limit_v_per_s=1e6)
    step_v = np.abs(np.diff(experiments.creep(limits).voltage_v)).max()
    assert 0.0 < step_v <= 1.001 * 1e6 / 40_000


def test_the_step_back_between_repeats_counts_for_the_slew_limit():
    ramp = experiments.Experiment("ramp", np.linspace(0.0, 100.0, 1000), 1e-3, 2, "")
    with pytest.raises(ValueError, match="slew"):
        experiments.fitting(StageLimits(), ramp)


def test_an_unknown_experiment_is_refused_with_the_names_there_are():
    with pytest.raises(ValueError, match="'swep'.*creep, dynamics, hysteresis, validation"):
        named_experiment("swep")


@pytest.mark.parametrize(("name", "rate_hz", "sentence"), [
    ("validation", 1000.0, "tones up to 1000 Hz need a sample clock of more than 2000 Hz, the "),
    ("multisine", 1000.0, "tones up to 600 Hz need a sample clock of more than 1200 Hz"),
    ("dynamics", 40.0, "a square wave of 0.02 s has no sample of 0.025 s in half a period"),
    ("hysteresis", 100.0, "holds each value for 0.001 s: make it a whole number of samples"),
    ("diagnostic", 100.0, "loops of up to 150 Hz need a sample clock of more than 300 Hz"),
])
def test_clock_that_is_too_slow_for_an_experiment_is_refused(name, rate_hz, sentence):
    with pytest.raises(ValueError, match=sentence):
        named_experiment(name, StageLimits(sample_rate_hz=rate_hz))
