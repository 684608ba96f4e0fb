# SPDX-License-Identifier: BSD-3-Clause
"""Which stage the demo runs on, and where its results go."""

from importlib import resources
from pathlib import Path

import pytest

from piezo_sim.plant.plant_file import PLANTS
from piezo_studies.demo.demo_command import main as demo_main
from piezo_studies.demo.demo_plant import SENTENCES, demo_plant


def test_usual_demo_writes_to_runs_demo():
    usual = demo_plant()
    assert usual.plant == "undeclared"
    assert usual.directory == Path("runs/demo")


def test_every_plant_of_the_simulator_has_its_sentence_and_its_directory():
    assert SENTENCES.keys() == PLANTS.keys()
    assert len({demo_plant(name).directory for name in PLANTS}) == len(PLANTS)
    assert demo_plant("beam").directory == Path("runs/demo-beam")


def test_plant_file_is_given_to_the_node_by_its_absolute_path(tmp_path, monkeypatch):
    text = (resources.files("piezo_sim") / "beam.yaml").read_text(encoding="utf-8")
    (tmp_path / "my stage.yaml").write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    mine = demo_plant("my stage.yaml")
    assert mine.plant == str(tmp_path / "my stage.yaml")
    assert mine.directory == Path("runs/demo-my stage")
    assert "my stage.yaml" in mine.sentence


def test_plant_that_is_none_ends_the_demo_before_anything_is_made(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        demo_main(["--plant", "cantilever"])
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "give a file or one of default, undeclared, beam" in said
    assert list(tmp_path.iterdir()) == []
