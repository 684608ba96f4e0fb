# SPDX-License-Identifier: BSD-3-Clause
"""Outputs at a few samples, beside those of all samples by the recursion of another library."""

import control
import numpy as np
import pytest
import scipy.signal

import piezo_models.linear.block_simulation as block_simulation
from piezo_models.linear.block_simulation import FEWEST, LONG
from piezo_models.linear.dynamics import zoh
from piezo_models.linear.outputs_at import simulate_linear_at

PERIOD_S = 25e-6
FEW_BLOCKS = 4
SAMPLES = 2 * FEWEST + 3 * LONG + 7
CHUNKS = np.concatenate([
    np.arange(100), FEW_BLOCKS * LONG + np.arange(-9, 9), SAMPLES - np.arange(30, 0, -1)])


@pytest.fixture(autouse=True)
def few_blocks_at_a_time(monkeypatch):
    monkeypatch.setattr(block_simulation, "BATCH", FEW_BLOCKS)


@pytest.mark.parametrize("at", [
    np.arange(0), np.arange(5), np.array([SAMPLES - 1]), CHUNKS,
    np.arange(SAMPLES // 4), np.arange(0, SAMPLES, 9), np.arange(5, SAMPLES),
], ids=["none", "first", "last", "chunks", "quarter", "one in some", "nearly all"])
def test_they_are_those_of_all_samples(at, thesis_creep, thesis_dynamics):
    creep, dynamics = thesis_creep.state_space(), thesis_dynamics.state_space()
    both = creep * dynamics
    system = zoh(control.append(both, creep) * np.ones((2, 1)), PERIOD_S)
    generator = np.random.default_rng(1)
    state, driven = generator.normal(size=system.nstates), generator.normal(size=SAMPLES)
    given = state.copy()
    _, expected, _ = scipy.signal.dlsim(
        (system.A, system.B, system.C, system.D, PERIOD_S), driven, x0=state)
    np.testing.assert_allclose(
        simulate_linear_at(system, driven, state, at), expected[at], atol=1e-9)
    np.testing.assert_array_equal(state, given)


def test_a_system_without_state_passes_its_input_on():
    system = zoh(control.ss([], [], [], [[2.0], [3.0]]), PERIOD_S)
    driven = np.random.default_rng(2).normal(size=SAMPLES)
    at = np.array([3, SAMPLES - 2])
    np.testing.assert_array_equal(
        simulate_linear_at(system, driven, np.zeros(0), at), np.outer(driven[at], [2.0, 3.0]))
