# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import replace

import numpy as np

from piezo_identification.fitting import dataset as module
from piezo_identification.fitting.dataset import SPLIT, simulate_recordings


def test_the_beginning_of_a_long_recording_is_fitted(plant, recorded):
    """It alone shows how far the creep had come: held-out rows would be anything otherwise."""
    count = 3 * SPLIT.most_rows
    voltage_v = 50.0 + 40.0 * np.sin(2.0 * np.pi * np.arange(count) / 5000.0)
    recording = recorded("long", voltage_v, plant.hysteresis.simulate(voltage_v), 1e-3)
    dataset = simulate_recordings(plant, [recording, recording])
    for part, rows, mask in zip(dataset.simulated, dataset.rows, dataset.masks(), strict=True):
        beginning = rows < part.begin + SPLIT.chunk
        assert np.count_nonzero(beginning) == SPLIT.chunk
        assert dataset.for_estimation[mask][beginning].all()


def test_every_recording_keeps_a_chunk_however_many_there_are(plant, recorded, monkeypatch):
    """Of the usual number of rows, more than 120 recordings would have less than a chunk each."""
    monkeypatch.setattr(module, "SPLIT", replace(SPLIT, most_rows=SPLIT.chunk))
    voltage_v = 50.0 + 40.0 * np.sin(2.0 * np.pi * np.arange(2000) / 500.0)
    recording = recorded("short", voltage_v, plant.hysteresis.simulate(voltage_v), 1e-3)
    dataset = simulate_recordings(plant, [recording, recording])
    assert [rows.size for rows in dataset.rows] == [SPLIT.chunk, SPLIT.chunk]
