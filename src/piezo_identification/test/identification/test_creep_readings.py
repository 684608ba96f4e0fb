# SPDX-License-Identifier: BSD-3-Clause
"""The rows of a creep recording are read as those of the dynamics, unless they show otherwise."""

import numpy as np
import pytest

from piezo_identification.conditioning.row_alignment import reading_at_jumps
from piezo_identification.identification.linear_dynamics import LinearDynamics, creep_of
from piezo_models.linear.dynamics import ElectricVibrationDynamics

PERIOD_S, NOISE_UM = 0.05, 2e-3
RATES, GAINS = np.array([0.03, 0.2, 1.5, 8.0]), np.array([0.01, 0.012, 0.012, 0.01])
LEVEL_UM = np.append(np.full(400, 2.0), np.repeat([8.0, 2.0, 8.0, 2.0, 8.0], 600))


def crept_um(read_at):
    """Sum of exponential lags, exact at the instant within the hold of each row."""
    states, kept = np.full(RATES.size, LEVEL_UM[0]), np.exp(-RATES * PERIOD_S)
    displacement_um = np.empty(LEVEL_UM.size)
    # A row read at the start of its hold does not know its voltage yet.
    for n, before in enumerate(np.append(LEVEL_UM[0], LEVEL_UM[:-1])):
        part = np.exp(-RATES * read_at * PERIOD_S)
        now = LEVEL_UM[n] if read_at else before
        displacement_um[n] = now + GAINS @ (part * states + (1.0 - part) * LEVEL_UM[n])
        states = kept * states + (1.0 - kept) * LEVEL_UM[n]
    return displacement_um


@pytest.mark.parametrize("read_at", [0.0, 1.0])
@pytest.mark.parametrize("of_dynamics", [0.0, 0.26, 1.0])
def test_jumps_tell_when_slow_rows_are_read_whatever_those_of_the_dynamics_do(
        recorded, read_at, of_dynamics):
    """A voltage that is measured with the displacement jumps in the same row."""
    recording = recorded("creep", 10.0 * LEVEL_UM, crept_um(read_at), PERIOD_S, NOISE_UM)
    assert reading_at_jumps(recording) == read_at
    ramp_v = np.linspace(0.0, 80.0, 2000)
    assert reading_at_jumps(recorded("ramp", ramp_v, 0.1 * ramp_v, PERIOD_S, NOISE_UM)) is None
    fast = ElectricVibrationDynamics(3e-4)
    found = LinearDynamics(dynamics=fast, read_at_samples=of_dynamics)
    assert creep_of([recording], found, True, 1)[1] == read_at


@pytest.mark.parametrize("read_at", [pytest.param(0.0, marks=pytest.mark.long), 1.0])
def test_creep_that_another_logger_recorded_is_not_shifted(recorded, read_at):
    """The dynamics' rows seem to be read 0.48 of their short period late, or are at their end."""
    found = LinearDynamics(read_at_samples=read_at or 0.48)
    recording = recorded("creep", 10.0 * LEVEL_UM, crept_um(read_at), PERIOD_S, NOISE_UM)
    estimate, found_at = creep_of([recording], found, False, None)
    assert found_at == read_at
    frequency_hz = np.geomspace(5e-3, 2.0, 20)
    rate = 2j * np.pi * frequency_hz[:, None]
    truth = 1.0 + np.sum(GAINS * RATES / (rate + RATES), axis=1)
    response = estimate.model.response(frequency_hz)
    np.testing.assert_allclose(response / response[-1], truth / truth[-1], atol=1e-3)
