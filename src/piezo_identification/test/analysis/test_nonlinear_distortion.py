# SPDX-License-Identifier: BSD-3-Clause
"""Noise, even and odd distortion against polynomials, a filter and a play, which are known."""

import numpy as np
import pytest
from made_by_scipy import logged
from scipy.signal import lfilter

from piezo_identification.analysis.nonlinear_distortion import distortion_of_signal
from piezo_identification.experiments.catalogue import StageLimits, distortion, named_experiment
from piezo_identification.recording_check.check import check_recording
from piezo_identification.recording_check.check_report import check_table

LIMITS = StageLimits(-20.0, 120.0, 2e5, 4000.0)


@pytest.fixture(scope="module")
def multisine():
    """Experiment, and its wave about zero with a peak of 1."""
    experiment = distortion(LIMITS)
    wave = experiment.voltage_v - LIMITS.middle_v
    return experiment, wave / np.abs(wave).max()


def measured(experiment, answer_um, noise_um=0.0):
    """Separate what periods of an answer show that follow the first one."""
    voltage_v = np.tile(experiment.voltage_v, experiment.repeats)
    noise = np.random.default_rng(3).normal(size=voltage_v.size)
    return distortion_of_signal(voltage_v, np.tile(answer_um, experiment.repeats)
                                + noise_um * noise, experiment.sample_period_s)


def power(signal, lines):
    return np.sum(np.abs(2.0 * np.fft.rfft(signal)[lines] / signal.size) ** 2)


@pytest.mark.parametrize(("square", "cube"), [(0.05, 0.0), (0.0, 0.05), (0.04, 0.02)])
def test_distortion_of_a_polynomial_is_that_of_its_terms(multisine, square, cube):
    experiment, wave = multisine
    found = measured(experiment, wave + square * wave**2 + cube * wave**3, 1e-5)
    lines = np.arange(1, found.frequency_hz.size + 1)
    answer = power(wave + cube * wave**3, lines[found.is_excited])
    even = power(square * wave**2, lines[found.is_even])
    odd_left_out = power(cube * wave**3, lines[found.is_odd_detection])
    share = np.count_nonzero(~found.is_even) / np.count_nonzero(found.is_odd_detection)
    assert found.percent(found.even_um) == pytest.approx(
        100.0 * np.sqrt(even / answer), rel=0.01, abs=2e-3)
    assert found.percent(found.odd_um) == pytest.approx(
        100.0 * np.sqrt(share * odd_left_out / answer), rel=0.01, abs=2e-3)


def test_noise_of_a_linear_stage_is_measured_and_no_distortion_found(multisine):
    experiment, wave = multisine
    settled = lfilter([0.2], [1.0, -0.8], np.tile(wave, 3))[-wave.size:]
    found = measured(experiment, settled, 0.01)
    # White noise of variance s^2 has the power 4 s^2 / N at each line.
    assert np.sqrt(np.mean(found.noise_um**2)) == pytest.approx(
        0.02 / np.sqrt(wave.size), rel=0.05)
    assert found.even_um < found.significant_um
    assert found.odd_um < found.significant_um


def test_distortion_of_a_play_is_odd(multisine):
    experiment, wave = multisine
    driven, followed, position = np.tile(wave, 3), [], 0.0
    for value in driven:
        position = min(max(position, value - 0.05), value + 0.05)
        followed.append(position)
    found = measured(experiment, np.array(followed[-wave.size:]), 1e-4)
    assert found.percent(found.odd_um) > 1.0
    assert found.even_um < 0.2 * found.odd_um


def test_check_of_a_recording_shows_the_distortion(multisine):
    experiment, wave = multisine
    count = wave.size * experiment.repeats
    answer_um = np.tile(wave + 0.05 * wave**2, experiment.repeats)
    answer_um += 1e-3 * np.random.default_rng(6).normal(size=count)
    recording = logged(np.tile(experiment.voltage_v, experiment.repeats), answer_um,
                       experiment.sample_period_s)
    row, = (line for line in check_table(check_recording(recording), {})
            if line.startswith("distortion"))
    found = measured(experiment, wave + 0.05 * wave**2, 1e-3)
    assert f"even {found.percent(found.even_um):.2g}" in row
    assert "odd" in row and row.split("odd")[1].count("not significant") == 1


def test_experiment_keeps_the_limits_and_excites_odd_lines_only():
    slow = StageLimits(-20.0, 120.0, 20_000.0, 4000.0)
    experiment = named_experiment("distortion", slow)
    assert np.abs(np.diff(experiment.voltage_v)).max() <= 5.0
    sizes = np.abs(np.fft.rfft(experiment.voltage_v - experiment.voltage_v.mean()))
    lines = np.flatnonzero(sizes > 1e-6 * sizes.max())
    assert np.all(lines % 2 == 1)
    odd = np.arange(1, lines[-1] + 1, 2)
    groups = [odd[n:n + 3] for n in range(0, odd.size - 2, 3)]
    assert all(np.isin(group, lines).sum() == 2 for group in groups[:-1])


@pytest.mark.parametrize("parameters", [{"periods": 2}, {"period_s": 0.01}])
def test_experiment_that_cannot_tell_is_refused(parameters):
    with pytest.raises(ValueError, match="experiment 'distortion' has"):
        distortion(LIMITS, **parameters)


def test_other_voltages_and_a_single_settled_period_show_no_distortion(multisine):
    experiment, wave = multisine
    full, left_out = (np.tile(each, 4) for each in (wave + np.roll(wave, 7) ** 2, wave))
    period_s = experiment.sample_period_s
    assert distortion_of_signal(full, full, period_s) is None
    assert distortion_of_signal(left_out, left_out, period_s) is not None
    assert distortion_of_signal(*[left_out[: 2 * wave.size]] * 2, period_s) is None
