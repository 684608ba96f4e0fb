# SPDX-License-Identifier: BSD-3-Clause
"""The examples of docs/from_python.md and the notebook of data run as they stand, without ROS."""

import importlib.util
import json
import math
from pathlib import Path

import pytest
from replaced import replaced
from short_design import FEW_SCALINGS
from short_identification import FEW_EFFECTS, FEW_POLES, WITHOUT_SEARCH

from piezo_offline import steps
from piezo_recorder.reading.recording import Recording

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "from_python.md"
NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))


def loaded(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


cells = loaded(ROOT / "tools" / "run_cells.py")
made = loaded(ROOT / "examples" / "make_recordings.py")


@pytest.fixture(scope="module", autouse=True)
def computed_once():
    """Identify and diagnose once what the page and the notebook both ask of the same recordings."""
    identified, diagnosed = {}, {}
    identify, diagnose = steps.identify_recordings, steps.diagnose_recordings

    def identify_once(progress, note, budget, **asked):
        key = repr({name: content(part) for name, part in asked.items()})
        if key not in identified:
            identified[key] = identify(progress=progress, note=note, budget=budget, **asked)
        return identified[key]

    def diagnose_once(model, recordings, *asked):
        key = id(model), repr([content(each) for each in recordings])
        if key not in diagnosed:
            diagnosed[key] = diagnose(model, recordings, *asked)
        return diagnosed[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(steps, "identify_recordings", identify_once)
        patch.setattr(steps, "diagnose_recordings", diagnose_once)
        with replaced(*FEW_SCALINGS, *FEW_POLES, *WITHOUT_SEARCH, *FEW_EFFECTS):
            yield
    assert len(identified) == len(diagnosed) == 1


def content(part):
    return part.displacement_um.tobytes() if isinstance(part, Recording) else part


@pytest.mark.usefixtures("without_pictures")
def test_examples_of_the_page_run_and_find_the_stage_that_was_made(tmp_path, monkeypatch, capsys):
    pytest.importorskip("xarray")
    monkeypatch.chdir(tmp_path)
    made.main(Path("made"))
    names = {}
    cells.run_cells([cell for cell in cells.cells_of(PAGE) if "piezo_client" not in cell], names)
    (mode,) = names["model"].model.dynamics.mode_frequencies_rad_per_s
    assert mode / (2.0 * math.pi) == pytest.approx(made.MODE_HZ, rel=1e-3)
    (pole,) = names["model"].model.creep.poles_rad_per_s
    assert 1.0 / pole == pytest.approx(made.CREEP_S, rel=0.02)
    assert names["prediction"].e_y_percent() < 0.5
    assert names["half"].voltage_v.size == 1000
    assert {"model.json", "controller.json"} <= {path.name for path in tmp_path.iterdir()}
    assert "std. dev. (Hz)" in capsys.readouterr().out


@pytest.mark.usefixtures("without_pictures")
def test_notebook_of_data_runs_and_shows_tables_and_pictures(tmp_path, monkeypatch):
    pytest.importorskip("pandas")
    monkeypatch.chdir(tmp_path)
    made.main(Path("runs/made"))
    shown = cells.run_cells(cells.cells_of(ROOT / "examples" / "from_your_data.ipynb"), {})
    forms = [each[0] for each in shown if each is not None]
    assert forms.count("png") >= 5 and forms.count("html") >= 4


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_stored_without_outputs_and_begins_with_text(path):
    document = json.loads(path.read_text(encoding="utf-8"))
    assert document["nbformat"] == 4
    assert document["cells"][0]["cell_type"] == "markdown"
    for cell in document["cells"]:
        assert cell.get("outputs", []) == [] and cell.get("execution_count") is None
        assert set(cell) <= {"cell_type", "id", "metadata", "source", "outputs",
                             "execution_count"}
    assert len({cell["id"] for cell in document["cells"]}) == len(document["cells"])
