# SPDX-License-Identifier: BSD-3-Clause
"""The effect of docs/adding_a_plant_effect.md, installed from outside, acts in a plant."""

import importlib
import re
import sys
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from pydantic import ValidationError

from piezo_sim.plant.plant import Plant
from piezo_sim.plant.plant_effect import PlantConfigError, Surroundings
from piezo_sim.plant.plant_file import effect_schema, parse_plant

PAGE = Path(__file__).parents[4] / "docs" / "adding_a_plant_effect.md"
DEFAULT = (resources.files("piezo_sim") / "plant.yaml").read_text(encoding="utf-8")
SURROUNDINGS = Surroundings(sample_period_s=25e-6, rest_voltage_v=0.0, seed=3)


def page_block(language):
    return re.search(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)[1]


@pytest.fixture
def gap(package_of_page, monkeypatch):
    """Return the text of the default plant with the page's entry, whose package is installed."""
    monkeypatch.syspath_prepend(package_of_page(PAGE.name))
    yield DEFAULT.replace("amplifier:\n", f"amplifier:\n{page_block('yaml')}", 1)
    sys.modules.pop("crossover_gap", None)


def test_effect_of_the_page_acts_where_the_plant_file_names_it(gap):
    voltage_v = 3.0 * np.sin(np.arange(4000) * 2.0 * np.pi / 800.0)
    with_gap = Plant(parse_plant(gap), SURROUNDINGS).respond(voltage_v)
    narrowed_v = np.where(np.abs(voltage_v) < 0.5, 0.0, voltage_v - 0.5 * np.sign(voltage_v))
    plain = Plant(parse_plant(DEFAULT), SURROUNDINGS)
    np.testing.assert_allclose(with_gap, plain.respond(narrowed_v), atol=1e-9)
    assert np.ptp(with_gap[1]) > 0.1


def test_parameter_of_the_page_is_checked_as_those_of_every_effect(gap):
    with pytest.raises(PlantConfigError, match=r'crossover_gap: half_width_v\.unit is "mV".*"V"'):
        parse_plant(gap.replace('V, source: "seen', 'mV, source: "seen'))
    with pytest.raises(PlantConfigError, match="crossover_gap: half_width_v must not be negative"):
        parse_plant(gap.replace("{value: 0.5", "{value: -0.5"))


def test_effect_whose_package_is_gone_is_refused_with_those_that_are_there(gap, monkeypatch):
    monkeypatch.setattr(sys, "path", sys.path[1:])
    with pytest.raises(PlantConfigError, match=r'effect \(found "crossover_gap"\); known are'):
        parse_plant(gap)


def test_effect_that_cannot_be_imported_is_refused_in_one_line(gap, monkeypatch):
    monkeypatch.setitem(sys.modules, "crossover_gap", None)
    with pytest.raises(PlantConfigError, match="'crossover_gap' cannot be loaded"):
        parse_plant(gap)


def test_effect_of_a_module_with_postponed_annotations_is_checked_as_any_other(tmp_path,
                                                                               monkeypatch):
    (tmp_path / "postponed_gap.py").write_text(
        "from __future__ import annotations\n" + page_block("python"), encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    schema = effect_schema(importlib.import_module("postponed_gap").CrossoverGap)
    half_width_v = {"value": 0.5, "unit": "V", "source": "the test"}
    entry = {"effect": "crossover_gap", "half_width_v": half_width_v}
    assert schema.model_validate(entry).half_width_v.value == 0.5
    with pytest.raises(ValidationError):
        schema.model_validate(entry | {"half_width_v": half_width_v | {"value": [0.5]}})


def test_effect_that_can_neither_be_started_nor_joined_to_others_is_refused():
    @dataclass(frozen=True)
    class Idle:
        name: ClassVar[str] = "idle"

    plant = parse_plant(DEFAULT)
    with pytest.raises(PlantConfigError, match="idle: it has neither state_space nor start"):
        Plant(replace(plant, sensor=(*plant.sensor, Idle())), SURROUNDINGS)
