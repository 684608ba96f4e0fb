# SPDX-License-Identifier: BSD-3-Clause
"""Reading plant files: the default is complete, and what is wrong is named in one sentence."""

from importlib import resources

import pytest
import yaml

from piezo_sim.plant.named_plants import AXES_PLANTS, PLANTS
from piezo_sim.plant.plant_effect import PlantConfigError
from piezo_sim.plant.plant_file import (
    BEAM_EFFECTS,
    EFFECTS,
    MECHANICS,
    effect_schema,
    parse_plant,
    read_plant,
)
from piezo_sim.simulated_stage import SimulatedStage


def default_content():
    return yaml.safe_load((resources.files("piezo_sim") / "plant.yaml").read_text())


def refusal(content):
    with pytest.raises(PlantConfigError) as refused:
        parse_plant(yaml.safe_dump(content))
    sentence = str(refused.value)
    assert "\n" not in sentence and sentence.endswith(".")
    return sentence


def test_default_plant_is_the_chain_of_chapter_4():
    plant = read_plant()
    chain = plant.amplifier + plant.stage + plant.sensor
    assert [effect.name for effect in chain] == [
        "voltage_amplifier",
        "preisach_hysteresis",
        "creep",
        "electric_lag",
        "vibration_mode",
        "vibration_mode",
        "displacement_sensor",
    ]
    first, second = plant.stage[-2:]
    # Coefficients of s in the denominators of G_ev.
    assert 2 * first.damping_ratio * first.frequency_rad_per_s == pytest.approx(3901, rel=1e-4)
    assert 2 * second.damping_ratio * second.frequency_rad_per_s == pytest.approx(805, rel=1e-4)


def test_a_plant_is_chosen_by_name_or_by_file(tmp_path):
    assert read_plant("default") == read_plant()
    plants = {name: read_plant(name) for name in PLANTS}
    assert all(one != other for one, other in zip(plants.values(), [*plants.values()][1:],
                                                  strict=False))
    path = tmp_path / "mine.yaml"
    path.write_text((resources.files("piezo_sim") / "beam.yaml").read_text())
    assert read_plant(path) == read_plant(str(path)) == plants["beam"]
    with pytest.raises(PlantConfigError, match="give a file or one of default, undeclared, beam"):
        read_plant("cantilever")


def test_the_beam_shares_no_form_with_the_default_plant():
    beam = read_plant("beam")
    names = {effect.name for effect in beam.amplifier + beam.stage + beam.sensor}
    assert names >= BEAM_EFFECTS.keys()
    default = read_plant()
    shared = names & {effect.name for effect in default.amplifier + default.stage + default.sensor}
    assert shared == {"displacement_sensor"}
    assert names - BEAM_EFFECTS.keys() - shared == {"thermal_drift", "distributed_lag"}


def entries_of(content):
    """Yield the entries of the effects of a plant file, of all its axes."""
    for part in content.get("axes", {"": content}).values():
        yield from (entry for section in part.values() for entry in section)
    if "mechanics" in content:
        yield content["mechanics"]


@pytest.mark.parametrize("plant", PLANTS | AXES_PLANTS)
def test_every_figure_of_a_plant_has_its_unit_and_a_source_that_says_something(plant):
    file = (PLANTS | AXES_PLANTS)[plant]
    content = yaml.safe_load((resources.files("piezo_sim") / file).read_text())
    figures = [(entry["effect"], name, figure) for entry in entries_of(content)
               for name, figure in entry.items() if name != "effect"]
    assert len(figures) >= 20
    for effect, name, figure in figures:
        kind = {**EFFECTS, **BEAM_EFFECTS, **MECHANICS}[effect]
        assert name in effect_schema(kind).model_fields
        assert len(figure["source"]) > 4, f"{effect}: {name}"


def test_a_parameter_without_value_unit_or_source_is_refused():
    for part in ("value", "unit", "source"):
        content = default_content()
        del content["stage"][2]["time_constant_s"][part]
        assert f"stage[2] electric_lag: time_constant_s.{part} is missing" in refusal(content)


@pytest.mark.parametrize(
    ("value", "complaint"),
    [
        (float("nan"), "value is not a finite number (found NaN)"),
        (float("inf"), "value is not a finite number (found Infinity)"),
        ("2e6", 'value is not a finite number (found "2e6")'),
        (True, "value is not a finite number (found true)"),
        (None, "value is not a finite number (found null)"),
        ([1.0], "value is not a finite number (found [1.0])"),
        (-1.0, "time_constant_s must be positive"),
    ],
)
def test_a_value_that_is_no_usable_number_is_refused(value, complaint):
    content = default_content()
    content["stage"][2]["time_constant_s"]["value"] = value
    assert complaint in refusal(content)


def test_a_list_with_a_bad_item_is_refused():
    content = default_content()
    content["stage"][1]["poles_rad_per_s"]["value"][3] = float("nan")
    assert "stage[1] creep: poles_rad_per_s.value[3] is not a finite number" in refusal(content)
    content["stage"][1]["poles_rad_per_s"]["value"] = 3.0
    assert "poles_rad_per_s.value is not a list (found 3.0)" in refusal(content)


def test_a_fractional_number_of_bits_is_refused():
    content = default_content()
    content["sensor"][0]["converter_bits"]["value"] = 15.5
    assert "converter_bits.value is not a whole number (found 15.5)" in refusal(content)


def test_a_wrong_unit_is_refused():
    content = default_content()
    content["stage"][2]["time_constant_s"]["unit"] = "ms"
    assert 'time_constant_s.unit is "ms"; state the value in "s"' in refusal(content)


def test_an_empty_source_is_refused():
    content = default_content()
    content["stage"][2]["time_constant_s"]["source"] = " "
    assert "time_constant_s.source is empty; give the source" in refusal(content)


def test_missing_and_unknown_parameters_are_named():
    content = default_content()
    parameter = content["stage"][2].pop("time_constant_s")
    assert "stage[2] electric_lag: time_constant_s is missing" in refusal(content)
    content["stage"][2] |= {"time_constant_s": parameter, "time_constant": parameter}
    assert "stage[2] electric_lag: time_constant is unknown" in refusal(content)


def test_missing_and_unknown_sections_are_named():
    content = default_content()
    sensor = content.pop("sensor")
    assert "sensor is missing" in refusal(content)
    assert "sensors is unknown" in refusal(content | {"sensor": sensor, "sensors": sensor})


@pytest.mark.parametrize("name", ["warp_drive", None, ["creep"]])
def test_an_unknown_effect_is_named_with_the_known_ones(name):
    content = default_content()
    content["stage"][0]["effect"] = name
    assert "stage[0].effect names an unknown effect" in refusal(content)
    assert "known are voltage_amplifier, preisach_hysteresis" in refusal(content)


@pytest.mark.parametrize("section", [None, {}, [], "creep"])
def test_a_section_that_is_no_list_of_effects_is_refused(section):
    sentence = refusal(default_content() | {"stage": section})
    assert sentence.endswith(("stage has 0 entries; give at least 1.", "; give a list."))


@pytest.mark.parametrize("text", ["", "3", "amplifier: [", "\t"])
def test_a_text_that_is_no_plant_is_refused(text):
    with pytest.raises(PlantConfigError):
        parse_plant(text)


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    path = tmp_path / "no plant.yaml"
    with pytest.raises(PlantConfigError, match="no plant.yaml: the plant file cannot be read"):
        read_plant(path)
    path.write_text("amplifier: 3\n")
    with pytest.raises(PlantConfigError, match="no plant.yaml: amplifier is not a list"):
        read_plant(path)


def test_a_stage_file_changes_the_stage(tmp_path):
    content = default_content()
    content["stage"][0]["offset_um"]["value"] += 10.0
    path = tmp_path / "plant.yaml"
    path.write_text(yaml.safe_dump(content))
    shifted = SimulatedStage(path)
    shifted.open()
    shifted.exchange([0.0])
    assert shifted.true_displacement_um[0] == pytest.approx(11.11, abs=0.02)


def test_a_stage_whose_displacement_would_jump_is_refused(tmp_path):
    path = tmp_path / "plant.yaml"
    content = default_content()
    for kept in (content["stage"][:1], content["stage"][:2]):
        path.write_text(yaml.safe_dump(content | {"stage": kept}))
        with pytest.raises(PlantConfigError, match="add an effect with a lag"):
            SimulatedStage(path)
