# SPDX-License-Identifier: BSD-3-Clause
"""A stage with an effect that another package registers goes on where it stopped, at any sample."""

import sys
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint
from typing import ClassVar

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from piezo_common import registered as registered_module
from piezo_models.cascade import StageModel
from piezo_models.effects import GROUP, Effect, known_effects
from piezo_models.effects.effect import PLACES, parameter
from piezo_models.hysteresis.hysteretic_creep import HystereticCreep
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics

PERIOD_S = 1e-4
SAMPLES = 300


@dataclass(frozen=True)
class Foreign(Effect):
    """What the effects of the other package have in common; `advance` is the one they inherit."""

    name: ClassVar[str] = "foreign"
    place: ClassVar[str] = "displacement"
    experiment: ClassVar[str] = "steps"

    strength: float = parameter("1", "linear", 0.0, 1.0)

    def apply(self, signal, sample_period_s, rest=None):
        first = signal[0] if rest is None else rest
        return first + lfilter([self.strength], [1.0, self.strength - 1.0], signal - first)

    @classmethod
    def starts(cls, evidence):
        return []


@dataclass(frozen=True)
class SlowAmplifier(Foreign):
    name: ClassVar[str] = "slow_amplifier"
    place: ClassVar[str] = "voltage"


@dataclass(frozen=True)
class SlowMount(Foreign):
    name: ClassVar[str] = "slow_mount"


@dataclass(frozen=True)
class SlowReading(Foreign):
    name: ClassVar[str] = "slow_reading"
    place: ClassVar[str] = "sensor"


@dataclass(frozen=True)
class Bearing(Foreign):
    name: ClassVar[str] = "bearing"
    place: ClassVar[str] = "linear"

    def state_space(self):
        return control.ss([[-200.0]], [[200.0 * self.strength]], [[1.0]], [[1.0 - self.strength]])


@dataclass(frozen=True)
class Bracket(Foreign):
    name: ClassVar[str] = "bracket"
    place: ClassVar[str] = "modes"

    participation: float = parameter("1", "linear", 0.0, 1.0, default=0.2)

    def state_space(self):
        w = 3000.0
        return control.ss([[0.0, w], [-w, -0.1 * w]], [[0.0], [w]], [[1.0, 0.0]], [[0.0]])


FOREIGN = {kind.name: kind for kind in (SlowAmplifier, SlowMount, SlowReading, Bearing, Bracket)}


@pytest.fixture
def announced(monkeypatch):
    """Return the effects that are known when another package registers its own."""
    monkeypatch.setitem(sys.modules, "foreign_effects", sys.modules[__name__])
    points = [EntryPoint(name, f"foreign_effects:{kind.__name__}", GROUP)
              for name, kind in FOREIGN.items()]
    monkeypatch.setattr(registered_module, "_announced", lambda group, path: points)
    return known_effects()


def stage(*effects):
    return StageModel(
        PreisachModel(-20.0, 120.0, np.tril(np.full((20, 20), 0.004)), -5.0),
        CreepDynamics((0.1,), (0.11,)), ElectricVibrationDynamics(5e-4, (5000.0,), (0.1,)),
        effects=effects, hysteretic_creep=HystereticCreep((5.0,), (0.01,), (0.02,)),
    )


def joined(model, voltage_v, edges):
    memory = model.memory()
    return np.concatenate([
        model.simulate(part, PERIOD_S, memory) for part in np.split(voltage_v, edges)])


def test_the_other_package_has_an_effect_at_every_place():
    assert {kind.place for kind in FOREIGN.values()} == set(PLACES)


@pytest.mark.parametrize("name", FOREIGN)
def test_a_registered_effect_acts_and_a_simulation_in_parts_is_the_whole(announced, name):
    model = stage(announced[name](0.3))

    @settings(max_examples=10, deadline=None)
    @given(edges=st.lists(st.integers(0, SAMPLES), max_size=6).map(sorted),
           seed=st.integers(0, 2**16))
    def holds(edges, seed):
        random = np.random.default_rng(seed)
        voltage_v = np.cumsum(random.normal(scale=5.0, size=SAMPLES)).clip(-20.0, 120.0)
        whole = model.simulate(voltage_v, PERIOD_S)
        np.testing.assert_allclose(joined(model, voltage_v, edges), whole, rtol=0.0, atol=1e-10)
        plain = replace(model, effects=()).simulate(voltage_v, PERIOD_S)
        assert np.abs(whole - plain).max() > 1e-3

    holds()


def test_a_simulation_in_parts_is_the_whole_with_all_registered_effects_at_once(announced):
    model = stage(*(announced[name](0.3) for name in FOREIGN))
    voltage_v = np.cumsum(np.random.default_rng(1).normal(scale=5.0, size=SAMPLES)).clip(-20, 120)
    np.testing.assert_allclose(
        joined(model, voltage_v, [1, 1, 7, 150]), model.simulate(voltage_v, PERIOD_S), rtol=0.0,
        atol=1e-10)
