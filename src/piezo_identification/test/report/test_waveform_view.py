# SPDX-License-Identifier: BSD-3-Clause
"""What is drawn of a recording is chosen by its waveform."""

import numpy as np
import pytest

from piezo_identification.report.parameter_table import rounded
from piezo_identification.report.waveform_view import mean_hold, view_of

CLOCK_S = 25e-6


def test_a_fast_square_wave_of_seconds_is_drawn_as_its_mean_period():
    number = np.arange(80_000)
    voltage_v = np.where((number // 400) % 2 == 0, 20.0, 80.0)
    noise_um = np.random.default_rng(1).normal(scale=0.1, size=number.size)
    view = view_of(voltage_v, CLOCK_S)
    assert (view.kind, view.samples, view.has_levels) == ("square", 800, True)
    assert view.periods > 95
    assert view.time_label == "time in the period (ms)"
    shape_um = np.sin(2.0 * np.pi * number / 800)
    mean_um = view.mean(shape_um + noise_um)
    assert np.std(mean_um - view.mean(shape_um)) == pytest.approx(
        0.1 / np.sqrt(view.periods), rel=0.2)


def test_a_generator_that_steps_a_sample_off_now_and_then_keeps_its_period():
    jumps = 400 * np.arange(1, 60) + np.random.default_rng(2).integers(0, 2, 59)
    voltage_v = np.where(np.searchsorted(jumps, np.arange(24_000), side="right") % 2, 80.0, 20.0)
    assert view_of(voltage_v, CLOCK_S).samples == pytest.approx(800, abs=1)


@pytest.mark.parametrize("voltage_v", [
    np.cumsum(np.random.default_rng(3).normal(size=5000)),
    np.repeat(np.random.default_rng(4).uniform(0.0, 100.0, 30), 200),
    # The experiment of the hysteresis: even cycles of rising amplitude from the lowest voltage.
    np.concatenate([-20.0 + 0.5 * top_v * (1.0 - np.cos(2.0 * np.pi * np.arange(200) / 200))
                    for top_v in np.linspace(2.0, 140.0, 70)]),
])
def test_a_voltage_that_does_not_repeat_itself_is_drawn_as_a_whole(voltage_v):
    view = view_of(voltage_v, 1e-3)
    assert (view.is_mean, view.samples, view.title) == (False, voltage_v.size, "whole recording")
    assert np.array_equal(view.mean(voltage_v), voltage_v)


def test_falling_steps_are_turned_round_for_the_mean():
    level = (np.arange(4000) // 1000) % 2
    since = np.arange(4000) % 1000
    displacement_um = (2.0 * level - 1.0) * (5.0 + np.log1p(since))
    since_s, (mean_um,), count = mean_hold(
        np.array([0, 1000, 2000, 3000]), 10.0 * level, [displacement_um], 0.01)
    assert count == 4 and since_s[-1] == pytest.approx(9.79)
    assert mean_um == pytest.approx(5.0 + np.log1p(np.arange(980)))


@pytest.mark.parametrize(("value", "deviation", "texts"), [
    (2846.214, 13.37, ("2846", "13")), (0.0827342, 0.000842, ("0.08273", "0.00084")),
    (0.5, np.inf, ("0.5", "")), (1e-12, 3.4e-14, ("1.000e-12", "3.4e-14")),
    (14285.3, 250.0, ("14285", "250")),
])
def test_a_value_has_the_digits_that_its_deviation_leaves(value, deviation, texts):
    assert rounded(value, deviation) == texts
