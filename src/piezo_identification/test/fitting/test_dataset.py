# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import replace

import numpy as np
import pytest

from piezo_identification.fitting import dataset as module
from piezo_identification.fitting.dataset import simulate_recordings

SPLIT = replace(module.SPLIT, most_rows=module.SPLIT.most_rows // 8)


@pytest.fixture(autouse=True)
def few_rows(monkeypatch):
    """Fit few rows, so that a long recording has no more than a short one."""
    monkeypatch.setattr(module, "SPLIT", SPLIT)


def test_the_beginning_of_a_long_recording_is_fitted(plant, recorded):
    """It alone shows how far the creep had come: held-out rows would be anything otherwise."""
    count = 3 * SPLIT.most_rows
    voltage_v = 50.0 + 40.0 * np.sin(2.0 * np.pi * np.arange(count) / 5000.0)
    recording = recorded("long", voltage_v, plant.hysteresis.simulate(voltage_v), 1e-3)
    dataset = simulate_recordings(plant, [recording, recording])
    chunk = SPLIT.most_rows // 2 // SPLIT.stretches
    for part, rows, mask in zip(dataset.simulated, dataset.rows, dataset.masks(), strict=True):
        beginning = rows < part.begin + chunk
        assert np.count_nonzero(beginning) == chunk
        assert dataset.for_estimation[mask][beginning].all()


@pytest.mark.parametrize("second", [
    0.501, *(pytest.param(second, marks=pytest.mark.long) for second in (0.5, 0.508))])
def test_rows_after_rare_steps_are_fitted(plant, recorded, second):
    """They alone show the first seconds of the creep."""
    count = 10 * SPLIT.most_rows
    steps = [count // 10, round(second * count)]
    voltage_v = np.repeat([20.0, 80.0, 20.0], np.diff([0, *steps, count]))
    recording = recorded("rare", voltage_v, plant.hysteresis.simulate(voltage_v), 1e-3)
    dataset = simulate_recordings(plant, [recording])
    [rows] = dataset.rows
    after = np.array(steps)[:, None] - 1 + np.arange(SPLIT.most_rows // SPLIT.stretches)
    assert np.isin(after, rows[dataset.for_estimation]).all()
    assert np.all(np.diff(rows) > 0)
    assert dataset.for_estimation.mean() > 0.6


def test_every_stretch_of_every_recording_is_seen_however_many_there_are(
        plant, recorded, monkeypatch):
    """A mode that a chirp passes within a few stretches would be missed otherwise."""
    monkeypatch.setattr(module, "SPLIT", replace(SPLIT, most_rows=1))
    voltage_v = 50.0 + 40.0 * np.sin(2.0 * np.pi * np.arange(2000) / 500.0)
    recording = recorded("short", voltage_v, plant.hysteresis.simulate(voltage_v), 1e-3)
    dataset = simulate_recordings(plant, [recording, recording])
    for mask in dataset.masks():
        assert np.unique(dataset.stretch[mask]).size == SPLIT.stretches
