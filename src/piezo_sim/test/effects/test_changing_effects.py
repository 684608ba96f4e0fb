# SPDX-License-Identifier: BSD-3-Clause
"""Effects of the plant that begin at a time of the stage."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from piezo_sim.effects.loaded_mode import LoadedMode
from piezo_sim.effects.switched_heat import SwitchedHeat
from piezo_sim.plant.linear_effects import ElectricLag, LinearRunner, VibrationMode
from piezo_sim.plant.plant_effect import PlantConfigError, Surroundings

PERIOD_S = 25e-6
W, ZETA = 3000.0, 0.05


def played(runner, samples, parts=40):
    """Play samples in parts of any size."""
    samples = samples.copy()
    for start in range(0, samples.size, parts):
        piece = samples[start : start + parts].copy()
        runner.apply(piece)
        samples[start : start + parts] = piece
    return samples


def test_a_mode_that_takes_up_mass_and_spring_moves_as_the_equation_of_motion():
    mass, stiffness, begin = 0.3, 0.1, 101
    mode = LoadedMode(W, ZETA, mass, stiffness, begin * PERIOD_S)
    runner = LinearRunner([mode], PERIOD_S)
    runner.rest(0.0)
    step = np.ones(400)
    found = played(runner, step)

    def motion(time_s, state):
        loaded = time_s >= begin * PERIOD_S
        m, k = 1.0 + mass * loaded, (1.0 + stiffness * loaded) * W**2
        position, velocity = state
        return [velocity, (W**2 - k * position - 2.0 * ZETA * W * velocity) / m]

    solution = solve_ivp(motion, (0.0, 400 * PERIOD_S), [0.0, 0.0], max_step=PERIOD_S,
                         t_eval=PERIOD_S * np.arange(400), rtol=1e-9, atol=1e-12)
    assert found == pytest.approx(solution.y[0], abs=1e-5)


def test_the_loaded_frequency_is_that_of_the_decay():
    runner = LinearRunner([LoadedMode(W, 1e-4, -0.0574, 0.0, 0.0)], PERIOD_S)
    impulse = np.zeros(40_000)
    impulse[0] = 1.0
    runner.apply(impulse)
    peak = np.argmax(np.abs(np.fft.rfft(impulse))) * 2 * np.pi
    assert peak == pytest.approx(1.03 * W, abs=2 * np.pi)


def test_parts_of_any_size_change_at_the_same_sample():
    effects = [ElectricLag(5e-4), LoadedMode(W, ZETA, 0.5, 0.0, 777 * PERIOD_S)]
    signal = np.random.default_rng(3).normal(size=2000)
    one, other = (played(LinearRunner(effects, PERIOD_S), signal, parts) for parts in (40, 2000))
    assert np.array_equal(one, other)
    before = played(LinearRunner([effects[0], VibrationMode(W, ZETA)], PERIOD_S), signal)
    assert np.array_equal(one[:778], before[:778]) and not np.allclose(one[800:], before[800:])


def test_heat_expands_from_its_time_on_towards_its_end():
    runner = SwitchedHeat(0.5, 0.02, 0.01).start(Surroundings(PERIOD_S, 0.0, 0))
    runner.rest(7.0)
    found = played(runner, np.full(40_000, 7.0), 37)
    time_s = PERIOD_S * np.arange(found.size)
    expected = 7.0 + np.where(time_s < 0.01, 0.0, 0.5 * (1.0 - np.exp((0.01 - time_s) / 0.02)))
    assert found == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(("kind", "numbers", "sentence"), [
    (LoadedMode, (W, ZETA, -1.0, 0.0, 0.0), "above -1"),
    (LoadedMode, (W, ZETA, 0.0, 0.0, -1.0), "begin_s must not be negative"),
    (SwitchedHeat, (1.0, 0.0, 0.0), "time_constant_s must be positive"),
])
def test_impossible_numbers_are_refused(kind, numbers, sentence):
    with pytest.raises(PlantConfigError, match=f"{kind.name}: .*{sentence}"):
        kind(*numbers)
