# SPDX-License-Identifier: BSD-3-Clause
"""Outliers among signals of all sorts: what moves as its neighbours do is none."""

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter, sawtooth

from piezo_models.effects.isolated_samples import MOST, isolated

SAMPLES = 20_000
TIME = np.arange(SAMPLES)


def played(voltage_v, half_width_v):
    """Return the output of a play operator."""
    output, last = np.empty_like(voltage_v), voltage_v[0]
    for n, level in enumerate(voltage_v):
        last = min(max(last, level - half_width_v), level + half_width_v)
        output[n] = last
    return output


def ringing(voltage_v, phase, damping_ratio, share):
    """Return the voltage, of which a share swings by so many radians a sample."""
    mode = [phase**2], [1.0, 2.0 * damping_ratio * phase, phase**2]
    b, a, _ = cont2discrete(mode, 1.0)
    swinging = lfilter(np.ravel(b), a, voltage_v - voltage_v[0]) + voltage_v[0]
    return (1.0 - share) * voltage_v + share * swinging


TRIANGLE_V = 50.0 + 40.0 * sawtooth(2.0 * np.pi * TIME / 2000.0, 0.5)
FAST_TRIANGLE_V = 50.0 + 40.0 * sawtooth(2.0 * np.pi * TIME / 37.0, 0.5)
SQUARE_V = np.where((TIME // 800) % 2, 90.0, 10.0)
NESTED_V = 50.0 + 30.0 * np.sin(TIME / 400.0) + 10.0 * np.sin(TIME / 9.5)
NOISE_V = 20.0 * np.random.default_rng(5).normal(size=SAMPLES)
SIGNALS = {
    "straight_triangle": (TRIANGLE_V, 0.1 * TRIANGLE_V),
    "fast_straight_triangle": (FAST_TRIANGLE_V, 0.1 * FAST_TRIANGLE_V),
    "triangle_with_hysteresis": (TRIANGLE_V, 0.05 * (TRIANGLE_V + played(TRIANGLE_V, 15.0))),
    "nested_loops": (NESTED_V, 0.05 * (NESTED_V + played(NESTED_V, 5.0))),
    # 1.5 kHz at 40 kHz.
    "weak_mode": (SQUARE_V, 0.1 * ringing(SQUARE_V, 0.2356, 0.02, 0.09)),
    "strong_mode": (SQUARE_V, 0.1 * ringing(SQUARE_V, 0.2356, 0.02, 1.0)),
    "mode_on_coarse_samples": (SQUARE_V, 0.1 * ringing(SQUARE_V, 1.885, 0.02, 0.5)),
    "mode_in_noise": (NOISE_V, 0.1 * ringing(NOISE_V, 0.7, 0.05, 1.0)),
}
SLOW = ("straight_triangle", "triangle_with_hysteresis", "nested_loops")


@pytest.mark.parametrize("noise_um", [0.0, 1e-3, 1e-2])
@pytest.mark.parametrize("name", SIGNALS)
def test_nothing_stands_out_of_what_a_stage_does(name, noise_um):
    voltage_v, displacement_um = SIGNALS[name]
    noise = noise_um * np.random.default_rng(1).normal(size=SAMPLES)
    assert not isolated(displacement_um + noise, voltage_v).any()


@pytest.mark.parametrize("name", SIGNALS)
def test_a_converters_steps_do_not_stand_out(name):
    voltage_v, displacement_um = SIGNALS[name]
    assert not isolated(0.02 * np.round(displacement_um / 0.02), voltage_v).any()


def dropped_out(displacement_um):
    """Return the runs at the zero of a converter in 1.5 % of the samples, and their mask."""
    generator = np.random.default_rng(2)
    wrong = np.zeros(SAMPLES, dtype=bool)
    while wrong.mean() < 0.015:
        begin = generator.integers(0, SAMPLES)
        wrong[begin : begin + generator.integers(1, 13)] = True
    return np.where(wrong, 0.0, displacement_um), wrong


@pytest.mark.parametrize("name", SLOW)
def test_drop_outs_are_found_in_runs_too(name):
    voltage_v, displacement_um = SIGNALS[name]
    noise = 1e-3 * np.random.default_rng(1).normal(size=SAMPLES)
    broken_um, wrong = dropped_out(displacement_um + noise)
    found = isolated(broken_um, voltage_v)
    far = wrong & (np.abs(displacement_um) > 1.0)
    assert found[far].mean() > 0.99
    assert np.count_nonzero(found & ~wrong) < 0.1 * np.count_nonzero(wrong)


@pytest.mark.parametrize("name", ["weak_mode", "strong_mode"])
def test_spikes_are_found_beside_ringing(name):
    voltage_v, displacement_um = SIGNALS[name]
    generator = np.random.default_rng(4)
    at = np.flatnonzero(TIME % 800 == 600)
    broken_um = displacement_um + 1e-3 * generator.normal(size=SAMPLES)
    broken_um[at] += generator.choice([-3.0, 3.0], at.size)
    np.testing.assert_array_equal(np.flatnonzero(isolated(broken_um, voltage_v)), at)


def test_a_row_that_was_put_in_hides_none_of_a_converters_steps():
    """Coarse ones, in a signal that rests: noise takes it to the next value and back."""
    step_um, rests_v = 0.0244, np.where(TIME < SAMPLES // 2, 10.0, 90.0)
    noise_um = 0.4 * step_um * np.random.default_rng(2).normal(size=SAMPLES)
    signal = step_um * np.round((0.1 * rests_v + noise_um) / step_um)
    signal[7000] = 0.5 * (signal[6999] + signal[7001]) + 0.25 * step_um
    assert not isolated(signal, rests_v).any()


def test_where_most_stands_out_it_is_the_signal():
    spikes = np.where(TIME % 7 == 0, 5.0, 0.0) + 1e-3 * NOISE_V
    assert np.mean(TIME % 7 == 0) > MOST
    assert not isolated(spikes, np.zeros(SAMPLES)).any()


def test_too_short_a_signal_tells_nothing():
    assert not isolated(np.array([0.0, 9.0, 0.0]), np.zeros(3)).any()


@pytest.mark.parametrize("place", [0, 1, -1, -3])
def test_samples_at_an_end_that_have_no_time_to_come_back_are_marked(place):
    time_s = np.arange(2000) / 1000.0
    voltage_v = 50.0 - 50.0 * np.cos(2.0 * np.pi * time_s)
    signal = 0.2 * voltage_v + np.random.default_rng(2).normal(0.0, 0.01, time_s.size)
    ends = slice(0, place + 1) if place >= 0 else slice(place, None)
    signal[ends] = -207.0
    wrong = isolated(signal, voltage_v)
    assert wrong[ends].all() and wrong.sum() == wrong[ends].sum()


def test_the_end_of_a_step_of_the_voltage_is_no_outlier():
    voltage_v = np.append(np.zeros(500), np.full(2, 100.0))
    signal = 0.2 * voltage_v + np.random.default_rng(2).normal(0.0, 0.01, voltage_v.size)
    assert not isolated(signal, voltage_v).any()
