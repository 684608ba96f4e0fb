# SPDX-License-Identifier: BSD-3-Clause
"""The plant's linear effects against the analytic solution of their differential equations."""

import numpy as np
import pytest

from piezo_sim.plant.linear_effects import Creep, ElectricLag, LinearRunner, VibrationMode
from piezo_sim.plant.plant_effect import PlantConfigError
from piezo_sim.plant.plant_file import read_plant

LINEAR = [effect for effect in read_plant().stage if hasattr(effect, "state_space")]
SAMPLE_PERIOD_S = 2.5e-5


def played(runner, levels):
    samples = np.array(levels, dtype=float)
    runner.apply(samples)
    return samples


def step_response(time_s):
    """Return the response of the default chain to a unit step, by partial fractions of G(s) / s."""
    zeros, poles, gain = [], [], 1.0
    for effect in LINEAR:
        if isinstance(effect, Creep):
            zeros += [-zero for zero in effect.zeros_rad_per_s]
            poles += [-pole for pole in effect.poles_rad_per_s]
        elif isinstance(effect, ElectricLag):
            poles.append(-1.0 / effect.time_constant_s)
            gain /= effect.time_constant_s
        else:
            w, zeta = effect.frequency_rad_per_s, effect.damping_ratio
            poles += [w * complex(-zeta, sign * np.sqrt(1.0 - zeta**2)) for sign in (1, -1)]
            gain *= w**2
    poles.append(0.0)
    poles, zeros = np.array(poles), np.array(zeros)
    started = time_s > 0.0
    response = np.zeros(time_s.shape, dtype=complex)
    for k, pole in enumerate(poles):
        residue = gain * np.prod(pole - zeros) / np.prod(pole - np.delete(poles, k))
        response += residue * np.exp(pole * np.where(started, time_s, 0.0))
    return np.where(started, response.real, 0.0)


def test_the_default_chain_has_every_linear_effect_of_the_thesis():
    assert [type(effect) for effect in LINEAR] == [Creep, ElectricLag, VibrationMode, VibrationMode]
    assert len(LINEAR[0].poles_rad_per_s) == 5


@pytest.mark.parametrize("sample_period_s", [SAMPLE_PERIOD_S, 1e-3, 0.5])
def test_held_inputs_give_the_continuous_solution_at_the_sample_instants(sample_period_s):
    changes = np.random.default_rng(2).normal(size=300)
    runner = LinearRunner(LINEAR, sample_period_s)
    time_s = sample_period_s * np.arange(changes.size)
    expected = sum(
        change * step_response(time_s - start)
        for change, start in zip(changes, time_s, strict=True)
    )
    assert played(runner, np.cumsum(changes)) == pytest.approx(expected, abs=1e-9)


def test_output_of_a_sample_does_not_depend_on_its_own_input():
    runner = LinearRunner(LINEAR, SAMPLE_PERIOD_S)
    assert played(runner, [1.0])[0] == 0.0
    assert played(runner, [0.0])[0] > 0.0


def test_rest_is_an_equilibrium_with_the_static_gain_of_creep():
    runner = LinearRunner(LINEAR, SAMPLE_PERIOD_S)
    resting = runner.rest(3.0)
    creep = LINEAR[0]
    static_gain = np.prod(creep.zeros_rad_per_s) / np.prod(creep.poles_rad_per_s)
    assert static_gain == pytest.approx(1.111, abs=5e-4)
    assert resting == pytest.approx(3.0 * static_gain, rel=1e-12)
    assert played(runner, np.full(40_000, 3.0)) == pytest.approx(resting, rel=1e-9)


def test_creep_passes_a_fast_change_with_unit_gain():
    lag = ElectricLag(time_constant_s=1e-6)
    after_lag = played(LinearRunner([LINEAR[0], lag], SAMPLE_PERIOD_S), [1.0, 1.0])[1]
    assert after_lag == pytest.approx(1.0, abs=1e-4)


def test_a_series_without_lag_is_refused():
    with pytest.raises(PlantConfigError, match="creep: .*add an effect with a lag"):
        LinearRunner([LINEAR[0]], SAMPLE_PERIOD_S)


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        (Creep, {"poles_rad_per_s": (1.0,), "zeros_rad_per_s": ()}),
        (Creep, {"poles_rad_per_s": (1.0,), "zeros_rad_per_s": (0.0,)}),
        (ElectricLag, {"time_constant_s": 0.0}),
        (VibrationMode, {"frequency_rad_per_s": -1.0, "damping_ratio": 0.1}),
        (VibrationMode, {"frequency_rad_per_s": 1.0, "damping_ratio": 0.0}),
    ],
)
def test_impossible_parameters_are_refused(effect, values):
    with pytest.raises(PlantConfigError, match=f"{effect.name}: .* must be"):
        effect(**values)
