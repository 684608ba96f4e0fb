# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from piezo_identification.experiments.input_designs import stair_amplitudes, stair_harmonics
from piezo_studies.baselines.polynomial_drift import remove_polynomial_drift
from piezo_studies.baselines.relay_grid import simulate_relays
from piezo_studies.baselines.relay_regression import (
    NormalEquations,
    accumulate,
    excitation_rank,
    projection,
    relay_rows,
)
from piezo_studies.baselines.sampling_rules import stair_sample_times
from piezo_studies.baselines.svd_estimate import density_by_svd, truncated_svd


def designed(level_count, highest_v):
    """Return the voltages of the input (4.6) at the instants of the rule (4.10), and the levels."""
    amplitudes_v = stair_amplitudes(level_count, highest_v)
    times_s = stair_sample_times(amplitudes_v, 1.0, amplitudes_v)
    voltage_v = stair_harmonics(times_s, amplitudes_v, 1.0)
    return voltage_v, np.linspace(0.0, highest_v, level_count + 1)


def loop_v(count=4000):
    """Return the sine of the thesis' 2.2.4, on 0 to 10 V."""
    return 5.0 * (1.0 - np.cos(5.0 * np.arange(count) * 1e-3))


def test_relay_rows_are_the_relays_one_by_one():
    rng = np.random.default_rng(0)
    levels_v, voltage_v = np.linspace(0.0, 6.0, 7), rng.uniform(0.0, 6.0, 100)
    weights = rng.uniform(size=21)
    i, j = np.tril_indices(6)
    expected = simulate_relays(voltage_v, i + 0.5, j + 0.5, weights)
    np.testing.assert_allclose(relay_rows(voltage_v, levels_v) @ weights, expected)


def test_accumulated_equations_are_those_of_the_whole_matrix(monkeypatch):
    monkeypatch.setattr("piezo_studies.baselines.relay_regression.ROWS_AT_ONCE", 7)
    rng = np.random.default_rng(1)
    levels_v, voltage_v = np.linspace(0.0, 6.0, 7), rng.uniform(0.0, 6.0, 100)
    output_um, samples = rng.normal(size=100), np.arange(3, 100, 4)
    rows = relay_rows(voltage_v, levels_v)[samples]
    equations = accumulate(voltage_v, output_um, levels_v, samples)
    np.testing.assert_allclose(equations.matrix, rows.T @ rows)
    np.testing.assert_allclose(equations.right_side, rows.T @ output_um[samples])
    assert equations.count == samples.size


def test_one_loop_excites_99_of_1275_densities():
    assert excitation_rank(loop_v(1300), np.linspace(0.0, 10.0, 51)) == 99


def test_the_designed_input_excites_all_densities():
    voltage_v, levels_v = designed(50, 10.0)
    assert voltage_v.size == 2551
    assert excitation_rank(voltage_v, levels_v) == 1275


@pytest.mark.long
def test_the_condition_number_at_60_levels_is_that_of_the_thesis():
    voltage_v, levels_v = designed(60, 60.0)
    assert voltage_v.size == 3661
    decomposition = truncated_svd(accumulate(voltage_v, np.zeros(3661), levels_v), rank=1830)
    condition = decomposition.singular_values[0] / decomposition.singular_values[-1]
    assert condition == pytest.approx(1.92e7, rel=1e-3)


def test_amplitudes_and_samples_in_the_middles_of_the_steps_excite_all_densities():
    amplitudes_v = stair_amplitudes(12, 60.0, below_the_top=0.5)
    times_s = stair_sample_times(amplitudes_v, 2.0, amplitudes_v)
    voltage_v = stair_harmonics(times_s, amplitudes_v, 2.0)
    assert (np.diff(times_s) > 0.0).all()
    assert times_s.size == 12 * 13 + 1
    assert excitation_rank(voltage_v, np.linspace(0.0, 60.0, 13)) == 78


def test_a_harmonic_starts_again_after_all_amplitudes():
    voltage_v = stair_harmonics(np.array([0.25, 0.75, 1.25, 2.25]) * 2.0, [1.0, 3.0], 2.0)
    np.testing.assert_allclose(voltage_v, [0.5, 0.5, 1.5, 0.5])


def test_truncation_gives_the_pseudo_inverse():
    rng = np.random.default_rng(2)
    rows = rng.normal(size=(30, 5)) @ rng.normal(size=(5, 12))
    output = rng.normal(size=30)
    equations = NormalEquations(12)
    equations.add(rows, output)
    decomposition = truncated_svd(equations, 1e-9)
    assert decomposition.rank == 5
    np.testing.assert_allclose(decomposition.solution(), np.linalg.pinv(rows) @ output)
    assert truncated_svd(equations, 0.5).rank < 5
    with pytest.raises(ValueError, match="keep fewer"):
        truncated_svd(NormalEquations(3))


def test_updates_at_full_rank_are_the_svd_of_the_enlarged_matrix():
    rng = np.random.default_rng(3)
    rows, output = rng.normal(size=(40, 10)), rng.normal(size=40)
    equations = NormalEquations(10)
    equations.add(rows[:4], output[:4])
    decomposition = truncated_svd(equations, 1e-9)
    for row, value in zip(rows[4:], output[4:], strict=True):
        decomposition = decomposition.updated(row, value, fixed_rank=False)
    singular_values = np.linalg.svd(rows, compute_uv=False) ** 2
    np.testing.assert_allclose(decomposition.singular_values, singular_values)
    rebuilt = (decomposition.vectors * decomposition.singular_values) @ decomposition.vectors.T
    np.testing.assert_allclose(rebuilt, rows.T @ rows, atol=1e-9)
    expected = np.linalg.lstsq(rows, output, rcond=None)[0]
    np.testing.assert_allclose(decomposition.solution(), expected)


def test_an_update_of_fixed_rank_keeps_the_largest_part():
    rng = np.random.default_rng(4)
    rows, row = rng.normal(size=(40, 10)), rng.normal(size=10)
    equations = NormalEquations(10)
    equations.add(rows, np.zeros(40))
    truncated = truncated_svd(equations, rank=6)
    updated = truncated.updated(row, 0.0)
    kept = (truncated.vectors * truncated.singular_values) @ truncated.vectors.T
    expected = np.linalg.eigvalsh(kept + np.outer(row, row))[::-1][:6]
    np.testing.assert_allclose(updated.singular_values, expected)


def test_the_svd_finds_the_density_and_reports_its_rank():
    voltage_v, levels_v = designed(12, 6.0)
    density = np.tril(1.0 + np.random.default_rng(5).uniform(size=(12, 12)))
    areas = 0.25 * (np.ones((12, 12)) - 0.5 * np.eye(12))
    output_um = relay_rows(voltage_v, levels_v) @ (density * areas)[np.tril_indices(12)]
    estimate = density_by_svd(
        truncated_svd(accumulate(voltage_v, output_um, levels_v), 1e-9), voltage_v, levels_v
    )
    np.testing.assert_allclose(estimate.density_um_per_v2, density, rtol=1e-6, atol=1e-9)
    assert estimate.rank == 78 and estimate.visited_fraction == 1.0
    assert estimate.singular_values.size == 78


def test_the_projection_converges_where_the_svd_is_there_at_once():
    rng = np.random.default_rng(6)
    rows, truth = rng.normal(size=(400, 5)), rng.normal(size=5)
    np.testing.assert_allclose(projection(rows, rows @ truth, 0.9, 1e-3), truth, atol=1e-6)
    one = projection(np.array([[3.0, 4.0]]), np.array([10.0]), 0.5, 25.0)
    np.testing.assert_allclose(one, 0.5 * 10.0 / 50.0 * np.array([3.0, 4.0]))
    with pytest.raises(ValueError, match="gain between 0 and 1"):
        projection(rows, rows @ truth, 1.0)


def test_the_projection_leaves_most_of_the_error_of_a_loop():
    levels_v, voltage_v = np.linspace(0.0, 10.0, 51), loop_v()
    rows = relay_rows(voltage_v, levels_v)
    weights = np.full(1275, 4.0 * 0.2**2)
    output_um = rows @ weights + 0.01 * np.random.default_rng(0).normal(size=4000)

    def error(estimate):
        return np.linalg.norm(estimate - weights) / np.linalg.norm(weights)

    assert error(projection(rows, output_um)) > 0.2
    assert error(truncated_svd(accumulate(voltage_v, output_um, levels_v), rank=99).solution()) < (
        0.005
    )


def test_a_polynomial_drift_is_taken_off():
    time_s = np.arange(0.0, 20.0, 0.1)
    harmonics_um = 1.0 - np.cos(2.0 * np.pi * time_s)
    drift_um = 0.000121 * time_s**2 + 0.0127 * time_s - 0.013
    rest = np.arange(0, 200, 10)
    corrected_um, drift = remove_polynomial_drift(time_s, harmonics_um + drift_um, rest)
    np.testing.assert_allclose(corrected_um, harmonics_um - 0.013, atol=1e-12)
    np.testing.assert_allclose(drift.convert().coef, [0.0, 0.0127, 0.000121], atol=1e-12)
    with pytest.raises(ValueError, match="too few"):
        remove_polynomial_drift(time_s, harmonics_um, rest[:2])
