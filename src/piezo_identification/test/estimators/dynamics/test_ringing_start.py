# SPDX-License-Identifier: BSD-3-Clause
"""A recording of the dynamics may begin while the stage rings from a step that is not in it."""

import numpy as np
import pytest

from piezo_identification.estimators.dynamics.fast_estimate import (
    AT_REST,
    WARM_UP_S,
    _first_kept,
)

PERIOD_S, REST_ROWS = 5e-5, 130


def motion_um(voltage_v, ringing_um):
    """A line, and a mode that still rings from before."""
    time_s = PERIOD_S * np.arange(voltage_v.size)
    return 0.1 * voltage_v + ringing_um * np.exp(-78.0 * time_s) * np.cos(
        2.0 * np.pi * 620.0 * time_s)


@pytest.mark.parametrize("ringing_um", [0.0, 0.5])
def test_a_rest_in_which_the_stage_rings_is_waited_out(recorded, ringing_um):
    """It lasts far longer than the rows before the next step."""
    voltage_v = np.append(np.zeros(REST_ROWS), np.tile(np.repeat([30.0, 0.0], 300), 40))
    first = _first_kept(recorded(
        "in motion", voltage_v, motion_um(voltage_v, ringing_um), PERIOD_S, 1e-3))
    if ringing_um:
        assert first * PERIOD_S >= WARM_UP_S
    else:
        # As soon as the second level was reached for long.
        assert REST_ROWS - AT_REST <= first < 1000


@pytest.mark.parametrize("ringing_um", [0.0, 0.5])
def test_a_chirp_that_begins_at_rest_is_kept_from_its_beginning(recorded, ringing_um):
    """It rests in no row, and its slowest waves are in its first tenths of a second alone."""
    time_s = PERIOD_S * np.arange(80_000)
    voltage_v = 5.0 * np.sin(2.0 * np.pi * (10.0 + 500.0 * time_s) * time_s)
    first = _first_kept(recorded(
        "chirp", voltage_v, motion_um(voltage_v, ringing_um), PERIOD_S, 1e-3))
    if ringing_um:
        assert first * PERIOD_S >= WARM_UP_S
    else:
        assert first * PERIOD_S < 0.1
