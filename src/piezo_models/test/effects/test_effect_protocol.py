# SPDX-License-Identifier: BSD-3-Clause
"""What the diagnosis asks of an effect besides its fit: its response, and what it is like."""

from dataclasses import dataclass
from typing import ClassVar

import control
import numpy as np
import pytest

from piezo_models.cascade import StageModel
from piezo_models.effects import known_effects
from piezo_models.effects.creep import Creep
from piezo_models.effects.delay import Delay
from piezo_models.effects.effect import Effect, parameter
from piezo_models.effects.sensor_lag import SensorLag
from piezo_models.effects.sensor_nonlinearity import SensorNonlinearity
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics

FREQUENCY_HZ, SAMPLE_PERIOD_S, PERIODS = 20.0, 2e-5, 100


@dataclass(frozen=True)
class FollowUp(Effect):
    """An effect of another package: a lag behind the modes, much the same as a delay."""

    name: ClassVar[str] = "follow_up"
    place: ClassVar[str] = "linear"
    experiment: ClassVar[str] = "steps"
    confounded_with: ClassVar[tuple[str, ...]] = ("delay",)

    time_constant_s: float = parameter("s", "logarithm", 1e-9, 1.0)

    def state_space(self):
        return control.ss([[-1.0 / self.time_constant_s]], [[1.0]],
                          [[1.0 / self.time_constant_s]], [[0.0]])

    def apply(self, signal, sample_period_s, rest=None):
        return signal

    @classmethod
    def starts(cls, evidence):
        return []


@pytest.mark.parametrize("effect", [
    Creep((0.2, 0.1), (0.01, 0.1)), Delay(3e-3), SensorLag(2e-3, 0.25), SensorLag(5e-3),
], ids=lambda effect: effect.name)
def test_the_response_is_what_a_sine_shows_behind_the_effect(effect):
    time_s = np.arange(round(PERIODS / FREQUENCY_HZ / SAMPLE_PERIOD_S)) * SAMPLE_PERIOD_S
    wave = np.exp(2j * np.pi * FREQUENCY_HZ * time_s)
    behind = effect.apply(wave.real, SAMPLE_PERIOD_S)
    settled = slice(-round(10 / FREQUENCY_HZ / SAMPLE_PERIOD_S), None)
    shown = 2.0 * np.mean((behind * wave.conj())[settled])
    told = effect.response(np.array([2j * np.pi * FREQUENCY_HZ]))[0]
    assert told == pytest.approx(shown, abs=2e-3)
    assert abs(told - 1.0) > 0.05


def test_an_effect_that_is_not_linear_leaves_the_response_as_it_is():
    curved = SensorNonlinearity(0.1, 0.1, 0.0, 0.0, 0.0, 1.0)
    assert (curved.response(np.array([1j, 100j])) == 1.0).all()


def test_a_linear_effect_of_another_package_is_part_of_the_response_of_the_model():
    plain, lagging = (
        StageModel(PreisachModel(0.0, 1.0, np.tril(np.ones((2, 2))), 0.0), CreepDynamics((), ()),
                   ElectricVibrationDynamics(0.0), effects=effects)
        for effects in ((), (FollowUp(1e-3),)))
    frequency_hz = np.array([10.0, 1000.0])
    ratio = lagging.response(frequency_hz) / plain.response(frequency_hz)
    assert ratio == pytest.approx(1.0 / (1.0 + 2j * np.pi * frequency_hz * 1e-3))


def test_an_effect_that_acts_on_a_signal_has_no_linear_system_and_says_so():
    with pytest.raises(NotImplementedError, match="delay acts on the displacement"):
        Delay(1e-3).state_space()


def test_it_is_enough_that_one_of_two_effects_names_the_other():
    assert FollowUp.is_confounded_with(Delay)
    assert Delay.is_confounded_with(FollowUp)
    assert not FollowUp.is_confounded_with(Creep)


@pytest.mark.parametrize("kind", known_effects().values(), ids=lambda kind: kind.name)
def test_effects_name_only_effects_that_there_are_and_not_themselves(kind):
    assert set(kind.confounded_with) <= set(known_effects()) - {kind.name}
