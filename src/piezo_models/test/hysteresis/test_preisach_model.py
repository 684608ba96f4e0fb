# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from piezo_models.hysteresis.preisach import PreisachModel
from piezo_studies.baselines.relay_grid import (
    activation_matrix,
    cell_centre_relays,
    simulate_relays,
)


def area_of_cell_in_triangle(model, i, j, alpha, beta):
    """Return the area of cell (i, j) within beta <= b <= a <= alpha, by elementary geometry."""
    levels = model.levels_v
    high = min(alpha, levels[i + 1])
    low = max(beta, levels[j])
    if i == j:
        return max(high - low, 0.0) ** 2 / 2
    return max(high - levels[i], 0.0) * max(levels[j + 1] - low, 0.0)


def refined(model, factor):
    """Return the same density on a grid `factor` times finer."""
    density = np.kron(model.density_um_per_v2, np.ones((factor, factor)))
    return PreisachModel(
        model.voltage_min_v, model.voltage_max_v, np.tril(density), model.offset_um
    )


def test_everett_is_the_density_times_the_area_in_every_cell(uneven_model):
    rng = np.random.default_rng(1)
    voltages = np.concatenate([rng.uniform(-20, 120, 60), uneven_model.levels_v])
    size = uneven_model.density_um_per_v2.shape[0]
    for alpha, beta in rng.choice(voltages, (60, 2)):
        expected = sum(
            uneven_model.density_um_per_v2[i, j]
            * area_of_cell_in_triangle(uneven_model, i, j, alpha, beta)
            for i in range(size)
            for j in range(i + 1)
            if alpha > beta
        )
        assert uneven_model.everett_um(alpha, beta) == pytest.approx(expected, rel=1e-13, abs=1e-13)


def test_the_reversible_part_adds_the_integral_along_the_diagonal():
    reversible = np.array([0.1, 0.0, 0.4, 0.2])
    density = np.tril(np.random.default_rng(0).uniform(0.0, 0.05, (4, 4)))
    model = PreisachModel(-20.0, 120.0, density, 1.0, reversible)
    without = PreisachModel(-20.0, 120.0, density, 1.0)
    voltage_v = np.random.default_rng(1).uniform(-30.0, 130.0, 300)
    integral_um = np.interp(voltage_v, model.levels_v, 35.0 * np.concatenate(
        [[0.0], np.cumsum(reversible)]))
    np.testing.assert_allclose(
        model.simulate(voltage_v), without.simulate(voltage_v) + integral_um, atol=1e-11)


def test_a_reversible_part_of_another_length_is_refused():
    with pytest.raises(ValueError, match="each of the 2 cells"):
        PreisachModel(0.0, 1.0, np.eye(2), reversible_um_per_v=[1.0])


def test_everett_broadcasts_and_is_limited_to_the_range(uneven_model):
    alpha, beta = np.array([[150.0], [50.0]]), np.array([-40.0, 10.0, 60.0])
    values = uneven_model.everett_um(alpha, beta)
    assert values.shape == (2, 3)
    assert values[0, 0] == uneven_model.everett_um(120.0, -20.0)
    assert values[1, 2] == 0.0


def test_everett_of_uniform_density_is_that_of_the_whole_triangle():
    model = PreisachModel(0.0, 10.0, np.tril(np.full((7, 7), 4.0)))
    alpha, beta = np.array([10.0, 9.1, 3.3, 0.01]), np.array([0.0, 8.9, 0.2, 0.0])
    np.testing.assert_allclose(model.everett_um(alpha, beta), 2 * (alpha - beta) ** 2, rtol=1e-13)


def test_output_converges_to_ever_finer_relays(uneven_model):
    rng = np.random.default_rng(2)
    voltage = np.repeat(rng.uniform(-25, 125, 300), 2)
    output = uneven_model.simulate(voltage)
    span = np.diff(uneven_model.output_range_um)[0]
    errors = []
    for factor in (1, 4, 16):
        relays = cell_centre_relays(refined(uneven_model, factor))
        errors.append(np.abs(simulate_relays(voltage, *relays, -3.0) - output).max() / span)
    assert errors[1] < errors[0] / 3
    assert errors[2] < errors[1] / 3
    assert errors[2] < 5e-3


def test_output_is_the_activation_matrix_times_the_density(uneven_model):
    rng = np.random.default_rng(3)
    voltage = np.concatenate([rng.uniform(-30, 130, 500), rng.choice(uneven_model.levels_v, 200)])
    cells = uneven_model.density_um_per_v2[np.tril_indices(20)]
    regression = activation_matrix(voltage, uneven_model.levels_v) @ cells
    np.testing.assert_allclose(
        uneven_model.simulate(voltage), regression + uneven_model.offset_um, atol=1e-12, rtol=0
    )


def test_negative_density_is_simulated_too():
    density = np.tril(np.random.default_rng(4).normal(size=(6, 6)))
    model = PreisachModel(0.0, 6.0, density, 1.0)
    voltage = np.random.default_rng(5).uniform(0, 6, 100)
    regression = activation_matrix(voltage, model.levels_v) @ density[np.tril_indices(6)]
    np.testing.assert_allclose(model.simulate(voltage), regression + 1.0, atol=1e-12)


def test_a_line_goes_on_beyond_the_range_and_a_hysteresis_saturates(uneven_model):
    line = PreisachModel(-1.0, 2.0, np.zeros((1, 1)), 0.5, np.array([3.0]))
    voltage_v = np.array([0.0, 5.0, 1.0, -4.0, 2.0])
    np.testing.assert_allclose(line.simulate(voltage_v) + line.line_beyond_um(voltage_v),
                               0.5 + 3.0 * (voltage_v + 1.0), atol=1e-12)
    assert not uneven_model.line_beyond_um(np.array([-1e3, 1e3])).any()


@pytest.mark.parametrize("slopes_um_per_v", [[3.0], [3.0, 3.0], [1.0, 0.0, 4.0]])
def test_a_line_or_curve_needs_no_memory(slopes_um_per_v):
    size = len(slopes_um_per_v)
    curve = PreisachModel(-1.0, 2.0, np.zeros((size, size)), 0.5, np.array(slopes_um_per_v))
    voltage_v = np.random.default_rng(6).uniform(-4.0, 5.0, 200)
    np.testing.assert_allclose(
        curve.line_um(voltage_v), curve.simulate(voltage_v) + curve.line_beyond_um(voltage_v),
        atol=1e-12)


def test_voltages_beyond_the_range_saturate_the_relays(uneven_model):
    low, high = uneven_model.output_range_um
    assert uneven_model.simulate([500.0, -500.0, 120.0, -20.0]).tolist() == [high, low, high, low]


def test_chunks_give_the_whole_to_the_bit(uneven_model):
    voltage = np.random.default_rng(6).uniform(-20, 120, 1000)
    memory = uneven_model.memory()
    chunks = [uneven_model.simulate(chunk, memory) for chunk in np.split(voltage, [1, 2, 500, 777])]
    assert np.array_equal(np.concatenate(chunks), uneven_model.simulate(voltage))
    assert memory.voltage_v == voltage[-1]


def test_copied_memory_has_a_past_of_its_own(uneven_model):
    memory = uneven_model.memory()
    uneven_model.simulate([80.0, 20.0, 60.0], memory)
    copy = memory.copy()
    uneven_model.simulate([120.0, 0.0], memory)
    expected = uneven_model.simulate([80.0, 20.0, 60.0, 30.0, 70.0])[3:]
    assert np.array_equal(uneven_model.simulate([30.0, 70.0], copy), expected)


def test_memory_of_another_model_is_refused(uneven_model):
    other = PreisachModel(-20.0, 120.0, uneven_model.density_um_per_v2)
    with pytest.raises(ValueError, match="another model"):
        other.simulate([1.0], uneven_model.memory())


def test_thousands_of_nested_extremes_are_remembered(uneven_model):
    amplitude = np.linspace(60, 0, 4000)
    inward = 50 + amplitude * np.where(np.arange(4000) % 2, -1, 1)
    memory = uneven_model.memory()
    going_in = uneven_model.simulate(inward, memory)
    assert memory.top == 4000
    # On the way out each extreme closes its own loop, so the outputs come back one by one.
    assert np.array_equal(uneven_model.simulate(inward[::-1], memory), going_in[::-1])


def test_sums_do_not_drift_over_a_million_samples(uneven_model):
    voltage = np.random.default_rng(8).uniform(-20, 120, 1_000_000)
    memory = uneven_model.memory()
    output = uneven_model.simulate(voltage, memory)
    remembered = memory.extremes_v[1 : memory.top + 1]
    assert memory.top < 60
    assert output[-1] == uneven_model.simulate(remembered)[-1]


def test_gain_bounds_hold_for_any_history(uneven_model):
    rng = np.random.default_rng(9)
    voltage = rng.uniform(-20, 120, 2000)
    output = uneven_model.simulate(voltage)
    for v, f in zip(voltage, output, strict=True):
        low, high = uneven_model.gain_um_per_v([v])
        gain = (f - uneven_model.offset_um) / (v - uneven_model.voltage_min_v)
        assert low - 1e-12 <= gain <= high + 1e-12


def test_gain_bounds_are_reached(uneven_model):
    low, high = uneven_model.gain_um_per_v([60.0])
    rising, falling = uneven_model.simulate([60.0, 120.0, 60.0])[[0, 2]] - uneven_model.offset_um
    assert (low, high) == pytest.approx((rising / 80.0, falling / 80.0), rel=1e-12)
    all_low, all_high = uneven_model.gain_um_per_v()
    assert all_low < low < high < all_high


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"density_um_per_v2": np.ones((2, 3))}, "shape"),
        ({"density_um_per_v2": np.ones((2, 2))}, "above the diagonal"),
        ({"density_um_per_v2": np.array([[np.nan]])}, "finite"),
        ({"voltage_min_v": 5.0}, "range"),
        ({"voltage_max_v": np.inf}, "range"),
        ({"offset_um": np.nan}, "offset_um"),
    ],
)
def test_senseless_models_are_refused(change, message):
    sound = dict(voltage_min_v=0.0, voltage_max_v=5.0, density_um_per_v2=np.eye(2), offset_um=0.0)
    with pytest.raises(ValueError, match=message):
        PreisachModel(**(sound | change))


@pytest.mark.parametrize("voltage", [[0.0, np.nan], [np.inf], [[1.0, 2.0]]])
def test_senseless_voltages_are_refused(uneven_model, voltage):
    with pytest.raises(ValueError, match="voltage_v"):
        uneven_model.simulate(voltage)


def test_density_cannot_be_changed_behind_the_tables(uneven_model):
    with pytest.raises(ValueError, match="read-only"):
        uneven_model.density_um_per_v2[0, 0] = 1.0
