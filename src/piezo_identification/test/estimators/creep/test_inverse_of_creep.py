# SPDX-License-Identifier: BSD-3-Clause
"""The inverse of slow creep keeps its digits over fast rows, whose poles are all near 1."""

import numpy as np
import pytest

from piezo_identification.estimators.creep.slow_creep import _Part
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag

PERIOD_S = 1e-3
VOLTAGE_V = np.repeat([20.0, 80.0, 40.0, 20.0], 8000)


def crept(rates, gains):
    """Displacement of a linear stage before the voltage of its row acts, in closed form."""
    held = np.append(VOLTAGE_V[0], VOLTAGE_V[:-1])
    time_s, jumps = np.arange(held.size) * PERIOD_S, np.flatnonzero(np.diff(VOLTAGE_V)) + 1
    total = held.copy()
    for rate, gain in zip(rates, gains, strict=True):
        total += gain * VOLTAGE_V[0]
        for jump in jumps:
            since_s = np.maximum(time_s - jump * PERIOD_S, 0.0)
            total -= gain * (VOLTAGE_V[jump] - VOLTAGE_V[jump - 1]) * np.expm1(-rate * since_s)
    return total


@pytest.mark.parametrize("pairs", [0, 1, 3, 6])
def test_what_the_creep_adds_is_taken_out(pairs):
    rates, gains = np.geomspace(0.003, 3.0, pairs), np.full(pairs, 0.03)
    displacement_um = crept(rates, gains)
    part = _Part(Recording(
        "closed form", 1.0 / PERIOD_S, np.arange(VOLTAGE_V.size),
        np.full(VOLTAGE_V.size, PERIOD_S), VOLTAGE_V, displacement_um,
        np.full(VOLTAGE_V.size, Flag.PLAYING, dtype=np.uint32)),
        np.linspace(20.0, 80.0, 33), 0.0, 2000)
    np.testing.assert_allclose(
        part.without_creep(rates, gains), part.means(VOLTAGE_V[:-1]), rtol=1e-9)
