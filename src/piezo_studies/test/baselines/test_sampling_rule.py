# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from piezo_identification.conditioning.waveforms import turning_points
from piezo_identification.experiments import catalogue as experiments
from piezo_studies.baselines.relay_grid import activation_matrix
from piezo_studies.baselines.sampling_rules import sample_by_voltage


@pytest.mark.parametrize("level_count", [4, 10, 70])
def test_the_rule_takes_every_level_of_every_branch_once(level_count):
    voltage_v = experiments.hysteresis(level_count=level_count).voltage_v
    levels_v = np.linspace(-20.0, 120.0, level_count + 1)
    samples = sample_by_voltage(voltage_v, levels_v)
    assert samples.size == level_count * (level_count + 1) + 1
    # Of the rule (4.10): up to level i and down again, i = 1..L.
    expected = np.concatenate(
        [[0], *(np.r_[1 : i + 1, i - 1 : -1 : -1] for i in range(1, level_count + 1))]
    )
    np.testing.assert_array_equal(
        np.round((voltage_v[samples] + 20.0) / (140.0 / level_count)), expected
    )


def test_no_other_sample_of_the_branch_is_nearer_to_its_level():
    voltage_v = experiments.hysteresis(level_count=7).voltage_v
    levels_v = np.linspace(-20.0, 120.0, 8)
    samples = sample_by_voltage(voltage_v, levels_v)
    distance_v = np.abs(voltage_v[samples, None] - levels_v).min(axis=1)
    for shift in (-1, 1):
        shifted = voltage_v[np.clip(samples + shift, 0, voltage_v.size - 1)]
        level_v = levels_v[np.abs(voltage_v[samples, None] - levels_v).argmin(axis=1)]
        assert np.all(np.abs(shifted - level_v) >= distance_v - 1e-9)


def test_the_input_of_the_rule_excites_every_cell_and_a_constant_amplitude_does_not():
    # Thesis, appendix A.2: ten cells; rank 10 for rising amplitudes, 7 for a single one.
    levels_v = np.arange(5.0)
    limits = experiments.StageLimits(0.0, 4.0)
    rising_v = experiments.hysteresis(limits, level_count=4).voltage_v
    rising = activation_matrix(rising_v, levels_v)[sample_by_voltage(rising_v, levels_v)]
    single_v = np.tile(rising_v[-2001:-1], 4)
    single = activation_matrix(single_v, levels_v)[sample_by_voltage(single_v, levels_v)]
    assert np.linalg.matrix_rank(rising) == 10
    assert np.linalg.matrix_rank(single) == 7


def test_turning_points_are_the_reversals_and_the_ends():
    voltage_v = np.array([0.0, 0.0, 1.0, 2.0, 2.0, 1.999, 2.0, 1.0, -1.0, 3.0, 3.0])
    np.testing.assert_array_equal(
        voltage_v[turning_points(voltage_v, 0.01)], [0.0, 2.0, -1.0, 3.0, 3.0]
    )


def test_a_voltage_that_never_moves_has_only_its_ends():
    np.testing.assert_array_equal(turning_points(np.ones(5), 0.1), [0, 4])
