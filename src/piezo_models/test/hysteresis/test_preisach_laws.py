# SPDX-License-Identifier: BSD-3-Clause
"""Laws of Preisach hysteresis and of its inverse, on random densities and histories."""

import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from piezo_models.hysteresis.preisach import PreisachModel

laws = settings(deadline=None, max_examples=150 if "LONG_TESTS" in os.environ else 60)


@st.composite
def models(draw, smallest_density=0.0):
    """Return the densities of 1 to 12 levels, up to nine cells in ten empty if zero is allowed.

    Half of them have a reversible part.
    """
    size = draw(st.integers(1, 12))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    density = rng.uniform(max(smallest_density, 1e-3), 0.05, (size, size))
    if smallest_density == 0.0:
        density[rng.random((size, size)) < draw(st.sampled_from([0.0, 0.5, 0.9]))] = 0.0
    reversible = draw(st.sampled_from([0.0, 1.0])) * rng.uniform(0.0, 0.5, size)
    return PreisachModel(-20.0, 120.0, np.tril(density), draw(st.floats(-5, 5)), reversible)


# Steps of 0.7 V meet the levels of many grids, and revisit extremes.
stepped_voltages = st.lists(st.integers(0, 200).map(lambda k: -20 + 0.7 * k), max_size=40)
voltages = st.one_of(stepped_voltages, st.lists(st.floats(-40, 140), max_size=40))


@laws
@given(models(), voltages)
def test_rate_does_not_matter(model, history):
    output = model.simulate(history)
    slow = np.repeat(history, 3)
    assert np.array_equal(model.simulate(slow)[::3], output)
    start = np.concatenate([[model.voltage_min_v], history])
    ramps = [np.linspace(a, b, 6)[1:] for a, b in zip(start[:-1], start[1:], strict=True)]
    on_ramps = model.simulate(np.concatenate([*ramps, []]))
    np.testing.assert_allclose(on_ramps[4::5], output, atol=1e-11)


@laws
@given(models(), voltages, voltages, st.floats(-20, 120))
def test_a_larger_swing_wipes_out_what_lies_inside(model, before, inside, after):
    low, high = (min(inside), max(inside)) if inside else (0.0, 0.0)
    plain = model.simulate([*before, low, high, after])[-1]
    assert model.simulate([*before, low, *inside, high, after])[-1] == plain


@laws
@given(models(), voltages, voltages, st.floats(-20, 120), st.floats(-20, 120))
def test_loops_between_equal_extremes_are_congruent(model, one, other, first, second):
    low, high = min(first, second), max(first, second)
    loop = np.concatenate([np.linspace(low, high, 15), np.linspace(high, low, 15)])
    shapes = []
    for history in (one, other):
        output = model.simulate([*history, low, high, *loop])[-30:]
        shapes.append(output - output[0])
    np.testing.assert_allclose(shapes[0], shapes[1], atol=1e-11)


@laws
@given(models(), voltages)
def test_output_never_moves_against_the_voltage(model, history):
    start = [model.voltage_min_v]
    moves = np.diff(model.simulate([*start, *history]))
    directions = np.diff(np.clip([*start, *history], -20, 120))
    assert (moves * np.sign(directions) >= -1e-12).all()
    low, high = model.output_range_um
    output = model.simulate(history)
    assert ((output >= low - 1e-12) & (output <= high + 1e-12)).all()


@laws
@given(models(), voltages)
def test_forward_of_inverse_is_the_target(model, history):
    target = model.simulate(history)
    reached = model.simulate(model.invert(target))
    np.testing.assert_allclose(reached, target, atol=1e-11, rtol=0)


@laws
@given(models(), st.lists(st.floats(0, 1), max_size=40), voltages)
def test_any_output_in_range_can_be_reached_from_any_past(model, fractions, past):
    low, high = model.output_range_um
    target = low + (high - low) * np.array(fractions)
    memory = model.memory()
    model.simulate(past, memory)
    voltage = model.invert(target, memory.copy())
    np.testing.assert_allclose(model.simulate(voltage, memory), target, atol=1e-11, rtol=0)


@laws
@given(models(smallest_density=1e-3), stepped_voltages)
def test_inverse_of_forward_is_the_voltage(model, history):
    np.testing.assert_allclose(model.invert(model.simulate(history)), history, atol=1e-10, rtol=0)


@laws
@given(models(smallest_density=1e-3), st.lists(st.floats(-20, 120), max_size=40))
def test_inverse_errs_no_more_than_rounding_allows_after_a_reversal(model, history):
    rounding = 1e-14 * sum(np.abs(model.output_range_um))
    np.testing.assert_allclose(
        model.invert(model.simulate(history)),
        history,
        atol=5 * np.sqrt(2 * rounding / 1e-3),
        rtol=0,
    )


@laws
@given(models(), voltages)
def test_inverse_goes_no_further_than_it_must_or_to_a_remembered_extreme(model, history):
    memory = model.memory()
    for v in np.clip(history, -20, 120):
        now = memory.voltage_v
        remembered = memory.extremes_v[: memory.top].tolist()
        ahead = memory.copy()
        target = model.simulate([v], ahead)
        found = model.invert(target, memory)[0]
        between = min(now, v) - 1e-5 <= found <= max(now, v) + 1e-5
        assert between or found in remembered
        memory = ahead


@laws
@given(models(), voltages)
def test_inverse_in_chunks_is_the_whole(model, history):
    target = model.simulate(history)
    memory = model.memory()
    chunks = [model.invert(chunk, memory) for chunk in np.array_split(target, 3)]
    assert np.array_equal(np.concatenate(chunks), model.invert(target))


@laws
@given(models(), st.lists(st.floats(0, 1), min_size=2, max_size=20))
def test_periodic_target_gives_periodic_voltage(model, fractions):
    low, high = model.output_range_um
    period = low + (high - low) * np.array(fractions)
    memory = model.memory()
    model.invert(period, memory)
    depth_after_one = memory.top
    second = model.invert(period, memory)
    third = model.invert(period, memory)
    np.testing.assert_allclose(third, second, atol=1e-5)
    assert np.array_equal(model.invert(period, memory), third)
    assert memory.top <= depth_after_one + 2


def test_held_target_holds_the_voltage_where_the_density_is_empty():
    density = np.zeros((4, 4))
    density[3, 0] = 1.0
    model = PreisachModel(0.0, 4.0, density)
    memory = model.memory()
    model.simulate([2.5], memory)
    assert model.invert([0.0, 0.0], memory).tolist() == [2.5, 2.5]
    # The output rises from 3 V on; coming back it stays flat down to 1 V.
    assert model.invert([0.5, 0.5, 0.25], memory) == pytest.approx([3.5, 3.5, 0.5])


def test_target_of_a_remembered_extreme_returns_to_it_and_closes_the_loop(uneven_model):
    memory = uneven_model.memory()
    outputs = uneven_model.simulate([90.0, 10.0, 70.0, 30.0, 50.0], memory)
    assert uneven_model.invert([outputs[3]], memory).tolist() == [30.0]
    assert memory.top == 4
    assert uneven_model.invert([outputs[0]], memory).tolist() == [90.0]
    assert memory.top == 1


@pytest.mark.parametrize("seed", range(100))
def test_rounding_moves_no_voltage_across_an_empty_stretch(seed):
    rng = np.random.default_rng(seed)
    density = np.tril(rng.random((6, 6)))
    density[3:5] = density[:, 3:5] = 0.0
    model = PreisachModel(0.0, 6.0, density, rng.uniform(-5, 5))
    low, high = rng.uniform(0, 3), rng.uniform(5, 6)
    rising, falling = [high, low, 4.0], [high, 4.0]
    assert model.invert(model.simulate(rising))[-1] <= 4.0
    assert model.invert(model.simulate(falling))[-1] >= 4.0


@pytest.mark.parametrize("outside", [-0.1, 0.1])
def test_unreachable_target_is_refused_with_the_range(uneven_model, outside):
    low, high = uneven_model.output_range_um
    memory = uneven_model.memory()
    uneven_model.simulate([33.0], memory)
    target = low + outside if outside < 0 else high + outside
    with pytest.raises(ValueError, match=f"reachable range is {low:.6g} to {high:.6g} um"):
        uneven_model.invert([0.0, target], memory)
    assert memory.voltage_v == 33.0


def test_both_ends_of_the_range_are_reached(uneven_model):
    voltage = uneven_model.invert([*uneven_model.output_range_um, 0.0])
    np.testing.assert_allclose(
        uneven_model.simulate(voltage), [*uneven_model.output_range_um, 0.0], atol=1e-12
    )


def test_target_that_is_not_finite_is_refused(uneven_model):
    with pytest.raises(ValueError, match="sample 1"):
        uneven_model.invert([0.0, np.nan])


def test_negative_density_has_no_inverse():
    model = PreisachModel(0.0, 2.0, np.array([[1.0, 0.0], [-0.1, 1.0]]))
    with pytest.raises(ValueError, match="negative cells"):
        model.invert([0.0])
