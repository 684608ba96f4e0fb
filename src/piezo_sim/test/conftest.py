# SPDX-License-Identifier: BSD-3-Clause
"""What the simulated stage is played in its tests."""

import numpy as np
import pytest

from piezo_sim.simulated_stage import SimulatedStage


@pytest.fixture
def wandering_voltage_v():
    """Return the voltages all over the range, with reversals everywhere, shape (10000,)."""
    steps = np.random.default_rng(7).normal(0.0, 3.0, 10_000)
    return 50.0 + 90.0 * np.sin(np.cumsum(steps) / 60.0)


@pytest.fixture(scope="session")
def exchanged():
    """Return the measured and true displacement of a plant, played in calls of `size` samples."""
    def exchange(voltage_v, size, plant=None):
        stage = SimulatedStage(plant, seed=3)
        stage.open()
        pairs = [
            (stage.exchange(voltage_v[first : first + size]), stage.true_displacement_um)
            for first in range(0, voltage_v.size, size)
        ]
        return tuple(np.concatenate(part) for part in zip(*pairs, strict=True))

    return exchange
