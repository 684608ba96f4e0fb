# SPDX-License-Identifier: BSD-3-Clause
"""The kernels run along whole branches; here they are compared with single samples and relays."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.hysteresis.preisach_inversion import invert_while_room
from piezo_models.hysteresis.preisach_kernels import everett_table, simulate_while_room
from piezo_studies.baselines.relay_grid import activation_matrix

laws = settings(deadline=None, max_examples=30)


def random_model(size, seed, emptiness=0.0, reversible=0.2):
    rng = np.random.default_rng(seed)
    density = rng.uniform(1e-3, 0.05, (size, size))
    density[rng.random((size, size)) < emptiness] = 0.0
    return PreisachModel(-20.0, 120.0, np.tril(density), 1.5, reversible * rng.random(size))


def branches_v(seed, turns, steps):
    """Return ramps of uneven steps between random turns, beyond the range now and then."""
    rng = np.random.default_rng(seed)
    corners_v = rng.uniform(-25.0, 125.0, turns)
    parts = [a + (b - a) * np.sort(rng.random(rng.integers(1, steps)))
             for a, b in zip(corners_v[:-1], corners_v[1:], strict=True)]
    return np.concatenate(parts)


def simulated_by_definition(model, voltage_v):
    """Return the output with the memory as the list of extremes, and Everett integrals of them."""
    extremes_v = [model.voltage_min_v]
    output_um = []
    for v in np.clip(voltage_v, model.voltage_min_v, model.voltage_max_v):
        # Entry 0 is negative saturation, odd entries are maxima; the last is the present point.
        rises = v > extremes_v[-1]
        if v != extremes_v[-1]:
            if (len(extremes_v) % 2 == 0) == rises and len(extremes_v) > 1:
                extremes_v.pop()
            while len(extremes_v) >= 2 and (
                    v >= extremes_v[-2] if rises and len(extremes_v) >= 3
                    else not rises and v <= extremes_v[-2]):
                del extremes_v[-2:]
            extremes_v.append(v)
        ups = zip(extremes_v[1::2], extremes_v[0::2], strict=False)
        downs = zip(extremes_v[1::2], extremes_v[2::2], strict=False)
        output_um.append(model.offset_um + sum(float(model.everett_um(*pair)) for pair in ups)
                         - sum(float(model.everett_um(*pair)) for pair in downs))
    return np.array(output_um)


@pytest.mark.parametrize("size", [1, 2, 7, 40])
def test_branches_of_uneven_steps_are_those_of_the_definition(size):
    model = random_model(size, seed=size)
    voltage_v = branches_v(seed=10 + size, turns=25, steps=12)
    np.testing.assert_allclose(model.simulate(voltage_v),
                               simulated_by_definition(model, voltage_v), rtol=1e-12)


def test_branches_are_those_of_the_relays_cell_by_cell():
    model = random_model(23, seed=3, emptiness=0.3, reversible=0.0)
    voltage_v = branches_v(seed=4, turns=60, steps=20)
    cells = model.density_um_per_v2[np.tril_indices(23)]
    relays_um = activation_matrix(voltage_v, model.levels_v) @ cells + model.offset_um
    np.testing.assert_allclose(model.simulate(voltage_v), relays_um, rtol=1e-12)


@laws
@given(st.sampled_from([1, 3, 30, 120]), st.integers(0, 2**32), st.sampled_from([2, 9, 70]),
       st.sampled_from([0.0, 0.9]))
def test_the_inverse_finds_the_cell_over_any_distance(size, seed, steps, emptiness):
    model = random_model(size, seed, emptiness, reversible=0.0)
    target_um = model.simulate(branches_v(seed + 1, turns=20, steps=steps))
    reached_um = model.simulate(model.invert(target_um))
    np.testing.assert_allclose(reached_um, target_um, rtol=0,
                               atol=1e-12 * np.ptp(model.output_range_um))


def test_the_inverse_is_the_first_voltage_that_reaches_the_target():
    model = random_model(120, seed=8, emptiness=0.95, reversible=0.0)
    rises_um = np.sort(np.random.default_rng(9).uniform(*model.output_range_um, 400))
    found_v = model.invert(rises_um)
    fine_v = np.linspace(-20.0, 120.0, 200_001)
    first = np.searchsorted(model.simulate(fine_v), rises_um)
    assert (found_v <= fine_v[first] + 1e-9).all()
    assert (found_v >= fine_v[first - 1] - 1e-9).all()


def test_the_tables_hold_two_numbers_for_each_pair_of_levels():
    model = random_model(40, seed=5)
    everett_um = model.everett_um(model.levels_v[:, None], model.levels_v[None, :])
    columns, rows, *diagonals = everett_table(
        model.density_um_per_v2, model.reversible_um_per_v, model.cell_width_v)
    np.testing.assert_allclose(rows, everett_um, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(columns.T, rows)
    assert columns.flags.c_contiguous
    assert all(diagonal.shape == (40,) for diagonal in diagonals)


@laws
@given(st.integers(0, 2**32), st.lists(st.integers(1, 5), min_size=1, max_size=40))
def test_blocks_of_any_length_give_the_whole_to_the_bit(seed, lengths):
    model = random_model(12, seed)
    voltage_v = branches_v(seed, turns=12, steps=8)
    ends = np.cumsum(lengths)
    ends = ends[ends < voltage_v.size]
    memory, inverse_memory = model.memory(), model.memory()
    output_um = model.simulate(voltage_v)
    blocks_um = [model.simulate(block, memory) for block in np.split(voltage_v, ends)]
    assert np.array_equal(np.concatenate(blocks_um), output_um)
    blocks_v = [model.invert(block, inverse_memory) for block in np.split(output_um, ends)]
    assert np.array_equal(np.concatenate(blocks_v), model.invert(output_um))


def inward_v(count):
    """Return ever smaller swings, none of which wipes out another."""
    return 50.0 + np.linspace(60.0, 1.0, count) * np.where(np.arange(count) % 2, -1.0, 1.0)


@pytest.mark.parametrize("direction", ["forward", "inverse"])
def test_a_full_memory_stops_the_kernel_where_it_can_go_on(direction):
    model = random_model(9, seed=2)
    voltage_v = inward_v(12)
    output_um = model.simulate(voltage_v)
    source, expected, kernel, settings_ = (
        (voltage_v, output_um, simulate_while_room, ()) if direction == "forward"
        else (output_um, model.invert(output_um), invert_while_room, (1e-12,)))
    extremes, outputs = np.full(5, np.nan), np.full(5, np.nan)
    extremes[0], outputs[0] = model.voltage_min_v, model.offset_um
    result = np.full(12, np.nan)
    n, top = kernel(source, result, 0, *settings_, extremes, outputs, 0, model._grid, model._table)
    assert (n, top) == (4, 4)
    assert np.isnan(result[4:]).all()
    longer = [np.concatenate([part, np.empty(20)]) for part in (extremes, outputs)]
    n, top = kernel(source, result, n, *settings_, *longer, top, model._grid, model._table)
    assert (n, top) == (12, 12)
    np.testing.assert_array_equal(result, expected)
