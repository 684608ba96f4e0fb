# SPDX-License-Identifier: BSD-3-Clause
"""Voltages that leave what a model was identified on are told, and how uncertain they are."""

import numpy as np
import pytest

from piezo_identification.commands.diagnose_command import main as diagnose_main
from piezo_identification.commands.simulate_command import main as simulate_main
from piezo_identification.estimators.hysteresis.everett_regression import visited_cells
from piezo_identification.prediction.outside_identified import outside_identified
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_models.model_file import save_model

CELLS = 50
TRUE_DENSITY = np.tril(0.002 + 0.004 * np.exp(
    -np.subtract.outer(np.arange(CELLS), np.arange(CELLS)) / 12.0))


def ways(*turns_v, samples=200):
    parts = [np.linspace(start, end, samples, endpoint=False)
             for start, end in zip(turns_v[:-1], turns_v[1:], strict=True)]
    return np.concatenate([*parts, turns_v[-1:]])


def identified_on(voltage_v):
    hysteresis = PreisachModel(0.0, 100.0, TRUE_DENSITY)
    return IdentifiedModel(
        StageModel(hysteresis, CreepDynamics(), ElectricVibrationDynamics()), (0.0, 100.0),
        visited=visited_cells(voltage_v, np.linspace(0.0, 100.0, CELLS + 1)))


ONE_LOOP_V = ways(0, 100, 0)
MINOR_V = ways(0, 70, 30, 60, 40)


@pytest.fixture
def one_loop():
    return identified_on(ONE_LOOP_V)


def test_what_was_visited_is_known(one_loop):
    found = outside_identified(one_loop, ONE_LOOP_V)
    assert not found.outside.any()
    assert found.sentences() == []


def test_minor_loops_beside_the_one_visited_are_told_by_sample(one_loop):
    found = outside_identified(one_loop, MINOR_V)
    # The first rise runs along the side of the triangle that the one loop ran along.
    assert not found.unvisited[:200].any()
    assert found.unvisited[230:].all()
    assert not found.beyond.any()
    (sentence,) = found.sentences()
    assert f"{100 * found.unvisited.mean():.3g} % of the samples lie in a part" in sentence


def test_the_uncertainty_is_that_of_densities_which_the_loop_cannot_tell_apart(one_loop):
    """Densities with the same major loop: rows of the plane exchange mass between columns."""
    random, outputs = np.random.default_rng(1), []
    truth = one_loop.model.hysteresis
    for _ in range(20):
        density = TRUE_DENSITY.copy()
        # Moved around rectangles, so that each row and each column keeps its sum.
        rows = np.sort(random.integers(1, CELLS, (1500, 2))).tolist()
        columns = np.sort(random.integers(0, CELLS, (1500, 2))).tolist()
        for (i, k), (j, m) in zip(rows, columns, strict=True):
            if i == k or j == m or m >= i:
                continue
            moved = random.uniform(-1.0, 1.0)
            moved *= min(density[i, j], density[k, m], density[i, m], density[k, j])
            density[i, j] += moved
            density[k, m] += moved
            density[i, m] -= moved
            density[k, j] -= moved
        outputs.append(PreisachModel(0.0, 100.0, density).simulate(MINOR_V))
    scatter_um = np.sqrt(np.mean((outputs - truth.simulate(MINOR_V)) ** 2, axis=0))
    deviation_um = outside_identified(one_loop, MINOR_V).deviation_um
    assert scatter_um[:200].max() < 1e-9
    assert scatter_um[400:].max() > 0.005
    assert np.all(scatter_um <= deviation_um + 1e-9)


def test_voltages_beyond_those_of_the_model_are_told(one_loop):
    voltage_v = ways(0, 130, 0)
    found = outside_identified(one_loop, voltage_v)
    assert found.beyond.mean() == pytest.approx(30.0 / 130.0, abs=0.01)
    slope = one_loop.model.hysteresis.gain_um_per_v()[1]
    assert found.deviation_um.max() == pytest.approx(30.0 * slope)
    assert "beyond the model's voltages, 0 to 100 V" in found.sentences()[0]


@pytest.mark.usefixtures("without_pictures")
def test_both_commands_say_it(one_loop, save_csv, tmp_path, capsys, picture_faults):
    model, path = tmp_path / "model.json", tmp_path / "beyond.csv"
    save_model(model, one_loop)
    voltage_v = ways(0, 130, 0, 100, 0, samples=300)
    wider = PreisachModel(0.0, 130.0, np.pad(TRUE_DENSITY, ((0, 15), (0, 15))), 0.0,
                          np.repeat([0.0, 0.1], [CELLS, 15]))
    noise = 0.01 * np.random.default_rng(2).normal(size=voltage_v.size)
    save_csv(path, np.arange(voltage_v.size) * 1e-2, voltage_v, wider.simulate(voltage_v) + noise)
    pictures = tmp_path / "pictures"
    assert picture_faults(simulate_main, [
        "--model", str(model), "--data", str(path), "--output", str(pictures)]) == []
    out = capsys.readouterr().out
    assert "of the samples lie beyond the model's voltages" in out
    whole, inside = (float(line.split()[1]) for line in out.splitlines()
                     if line.startswith("e_y_percent"))
    assert inside < 0.2 * whole
    assert diagnose_main(["--model", str(model), "--data", str(path), "--budget", "1e-9",
                          "--output", str(tmp_path / "out")]) == 0
    assert "of the samples lie beyond the model's voltages" in capsys.readouterr().out
    assert "beyond the model" in (tmp_path / "out" / "report.html").read_text()
