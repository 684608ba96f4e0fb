# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from piezo_models.linear.dynamics import simulate_linear, zoh

PERIOD_S = 25e-6


def test_stage_at_rest_stays_at_rest(stage):
    displacement = stage.simulate(np.zeros(5000), PERIOD_S)
    held = stage.hysteresis.simulate([0.0])[0]
    np.testing.assert_allclose(displacement, held * stage.response(0.0).real, rtol=1e-9)


def test_simulation_is_the_hysteresis_through_the_linear_dynamics(stage):
    voltage = np.random.default_rng(0).uniform(-20, 120, 500)
    hysteresis = stage.hysteresis.simulate(np.concatenate([[0.0], voltage]))[1:]
    expected = simulate_linear(zoh(stage.linear(), PERIOD_S), hysteresis)
    memory = stage.memory(settled=False)
    np.testing.assert_allclose(stage.simulate(voltage, PERIOD_S, memory), expected, rtol=1e-12)


def test_settled_stage_responds_like_a_long_rested_one(stage):
    slow = stage.simulate(np.full(2000, 40.0), 1.0, stage.memory(settled=False))
    after_rest = stage.memory(rest_voltage_v=40.0)
    assert stage.simulate([40.0], 1.0, after_rest)[0] == pytest.approx(slow[-1], rel=1e-9)


def test_continued_in_chunks_is_the_whole_to_the_bit(stage):
    voltage = np.random.default_rng(1).uniform(-20, 120, 300)
    memory = stage.memory()
    chunks = [stage.simulate(chunk, PERIOD_S, memory) for chunk in np.split(voltage, [1, 200])]
    assert np.array_equal(np.concatenate(chunks), stage.simulate(voltage, PERIOD_S))


def test_given_past_is_kept_and_left_alone(stage):
    past = stage.hysteresis.memory()
    stage.hysteresis.simulate([110.0, 30.0], past)
    memory = stage.memory(hysteresis=past)
    copy = memory.copy()
    displacement = stage.simulate([30.0, 30.0], PERIOD_S, memory)
    held = past.hysteresis_um * stage.response(0.0).real
    np.testing.assert_allclose(displacement, held, rtol=1e-9)
    stage.simulate([-20.0] * 5, PERIOD_S, memory)
    assert past.voltage_v == 30.0
    assert np.array_equal(stage.simulate([30.0, 30.0], PERIOD_S, copy), displacement)


def test_linear_part_has_the_product_of_the_responses(stage):
    frequency = np.logspace(-3, 4, 50)
    np.testing.assert_allclose(
        stage.linear()(2j * np.pi * frequency), stage.response(frequency), rtol=1e-9, atol=1e-15
    )
