# SPDX-License-Identifier: BSD-3-Clause
"""The plant's Preisach hysteresis against quadrature, relays and the laws of the operator."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import dblquad

from piezo_sim.plant.continuous_preisach import (
    HysteresisRunner,
    PreisachHysteresis,
    density_um_per_v2,
    everett_um,
)
from piezo_sim.plant.plant_effect import PlantConfigError
from piezo_sim.plant.plant_file import read_plant

DEFAULT = next(effect for effect in read_plant().stage if isinstance(effect, PreisachHysteresis))
SATURATION_V, TOP_V = -20.0, 120.0

# The first example may compile.
unhurried = settings(deadline=None)
voltages = st.floats(SATURATION_V, TOP_V)


def hysteresis_um(*voltage_v):
    samples = np.array(voltage_v, dtype=float)
    HysteresisRunner(DEFAULT).apply(samples)
    return samples


@pytest.mark.parametrize(
    ("alpha_v", "beta_v"), [(120.0, -20.0), (50.0, 47.0), (0.01, 0.0), (110.0, 60.0), (5.0, -20.0)]
)
def test_closed_form_is_the_double_integral_of_the_density(alpha_v, beta_v):
    integral, _ = dblquad(
        lambda beta, alpha: density_um_per_v2(alpha, beta, *DEFAULT.shape),
        beta_v,
        alpha_v,
        lambda alpha: beta_v,
        lambda alpha: alpha,
        epsabs=1e-12,
        epsrel=1e-11,
    )
    assert everett_um(alpha_v, beta_v, *DEFAULT.shape) == pytest.approx(integral, rel=1e-8)


def test_an_empty_triangle_holds_nothing():
    assert everett_um(30.0, 30.0, *DEFAULT.shape) == 0.0


def test_density_is_positive_on_the_whole_triangle():
    grid_v = np.linspace(SATURATION_V, TOP_V, 281)
    density = [
        density_um_per_v2(alpha, beta, *DEFAULT.shape)
        for alpha in grid_v
        for beta in grid_v[grid_v <= alpha]
    ]
    assert min(density) > 1e-4


def test_density_is_no_sum_of_a_function_of_alpha_and_one_of_beta():
    # A density f(alpha) + g(beta) has no mixed second difference anywhere.
    def mixed_difference(alpha_v, beta_v, step_v=5.0):
        corners = [
            density_um_per_v2(alpha_v + a, beta_v + b, *DEFAULT.shape)
            for a in (0.0, step_v)
            for b in (0.0, step_v)
        ]
        return (corners[3] - corners[2] - corners[1] + corners[0]) / np.mean(corners)

    near, middle, far = [mixed_difference(60.0 + d, 55.0 - d) for d in (5.0, 15.0, 40.0)]
    assert min(abs(near), abs(middle)) > 0.1
    assert abs(far) > 1e-3


def test_output_is_the_sum_over_relays():
    cells = 280
    step_v = (TOP_V - SATURATION_V) / cells
    alpha_cell, beta_cell = np.tril_indices(cells)
    on_diagonal = alpha_cell == beta_cell
    # Off the diagonal a cell is a square about its centre, on it a triangle about its centroid.
    alpha_v = SATURATION_V + step_v * (alpha_cell + np.where(on_diagonal, 2 / 3, 0.5))
    beta_v = SATURATION_V + step_v * (beta_cell + np.where(on_diagonal, 1 / 3, 0.5))
    weight_um = step_v**2 * np.where(on_diagonal, 0.5, 1.0)
    weight_um *= [
        density_um_per_v2(a, b, *DEFAULT.shape) for a, b in zip(alpha_v, beta_v, strict=True)
    ]

    levels = np.random.default_rng(11).integers(0, cells + 1, 150)
    voltage_v = SATURATION_V + step_v * levels
    relays_on = np.zeros(alpha_v.size, dtype=bool)
    expected_um = np.empty(voltage_v.size)
    for n, voltage in enumerate(voltage_v):
        relays_on = (relays_on | (alpha_v <= voltage)) & (beta_v <= voltage)
        expected_um[n] = weight_um[relays_on].sum() + DEFAULT.offset_um

    assert np.ptp(expected_um) > 100.0
    assert hysteresis_um(*voltage_v) == pytest.approx(expected_um, abs=0.02)


@unhurried
@given(st.lists(voltages, min_size=1, max_size=20), voltages, st.floats(0.0, 1.0))
def test_points_on_the_way_do_not_matter(history_v, end_v, fraction):
    way_v = history_v[-1] + fraction * (end_v - history_v[-1])
    direct = hysteresis_um(*history_v, end_v)[-1]
    assert hysteresis_um(*history_v, way_v, way_v, end_v)[-1] == pytest.approx(direct, abs=1e-10)


@unhurried
@given(
    st.lists(voltages, min_size=1, max_size=10),
    st.lists(voltages, min_size=1, max_size=10),
    st.tuples(voltages, voltages).map(sorted),
    st.floats(0.0, 1.0),
)
def test_loops_between_the_same_voltages_are_congruent(one_v, other_v, ends_v, fraction):
    low_v, high_v = ends_v
    loop_v = [high_v, low_v, low_v + fraction * (high_v - low_v), high_v]
    one_um = hysteresis_um(*one_v, low_v, *loop_v)[-4:]
    other_um = hysteresis_um(*other_v, low_v, *loop_v)[-4:]
    assert one_um - one_um[1] == pytest.approx(other_um - other_um[1], abs=1e-10)


def test_output_follows_a_rising_voltage_and_saturates_below():
    rising_um = hysteresis_um(*np.linspace(SATURATION_V, TOP_V, 500))
    assert np.all(np.diff(rising_um) > 0.0)
    assert hysteresis_um(80.0, SATURATION_V, -25.0)[1:] == pytest.approx(DEFAULT.offset_um)


def test_memory_grows_with_the_number_of_extremes():
    shrinking_v = 50.0 + 69.0 * 0.995 ** np.arange(900) * (-1.0) ** np.arange(900)
    whole_um = hysteresis_um(*shrinking_v, TOP_V)
    runner = HysteresisRunner(DEFAULT)
    parts = np.split(np.append(shrinking_v, TOP_V), range(30, 900, 30))
    for part in parts:
        runner.apply(part)
    assert np.array_equal(np.concatenate(parts), whole_um)
    assert whole_um[-1] == pytest.approx(hysteresis_um(TOP_V)[0], abs=1e-10)


def test_default_stage_has_the_gain_and_the_loop_of_the_thesis():
    sweep_v = np.linspace(SATURATION_V, TOP_V, 1401)
    up_um = hysteresis_um(*sweep_v)
    down_um = hysteresis_um(TOP_V, *sweep_v[::-1])[:0:-1]
    travel_um = up_um[-1] - up_um[0]
    assert travel_um == pytest.approx(133.0, abs=2.0)
    assert 0.10 < np.max(down_um - up_um) / travel_um < 0.15
    # Gains (3.16) at mid travel: k_h = 0.96 um/V and w_u = 0.12 of thesis 5.3.1.
    middle = sweep_v.size // 2
    smallest, largest = (
        (branch_um[middle] - up_um[0]) / (sweep_v[middle] - SATURATION_V)
        for branch_um in (up_um, down_um)
    )
    assert (largest + smallest) / 2 == pytest.approx(0.96, rel=0.03)
    assert (largest - smallest) / (largest + smallest) == pytest.approx(0.12, abs=0.01)


@pytest.mark.parametrize(
    "change",
    [
        {"position_modulation": -1.0},
        {"broad_density_um_per_v2": -1e-5},
        {"broad_density_um_per_v2": 0.0, "ridge_density_um_per_v2": 0.0},
        {"ridge_width_v": 0.0},
        {"modulation_period_v": -1.0},
    ],
)
def test_a_density_that_is_not_positive_is_refused(change):
    with pytest.raises(PlantConfigError, match="positive|negative"):
        PreisachHysteresis(**(vars(DEFAULT) | change))
