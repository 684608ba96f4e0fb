# SPDX-License-Identifier: BSD-3-Clause
"""A recording with gaps becomes its stretches in which something moves."""

from dataclasses import replace

import numpy as np
import pytest

from piezo_identification.conditioning.segments import played_segments

PERIOD_S = 1e-4


@pytest.fixture
def recording(recorded):
    """A square wave whose rows 1200 to 1400 and 1450 to 1500 are missing: it rests between."""
    voltage_v = np.repeat(np.tile([47.0, 62.0], 2), 1000)
    whole = recorded("dropped.csv", voltage_v, 0.5 * voltage_v, PERIOD_S, 0.01)
    kept = np.ones(voltage_v.size, dtype=bool)
    kept[1200:1400] = kept[1450:1500] = False
    return replace(whole.select(kept), gaps=[(1200, 200), (1450, 50)])


def test_a_stretch_in_which_the_voltage_rests_is_left_out(recording):
    first, last = played_segments(recording)
    assert (first.sample_index[-1], last.sample_index[0]) == (1199, 1500)
    assert not first.gaps and not last.gaps


def test_a_recording_that_moves_in_its_gaps_alone_is_refused(recording):
    resting = recording.select(recording.sample_index < 1000)
    moved = replace(resting, gaps=[(500, 1)], voltage_v=np.where(
        resting.sample_index < 500, 47.0, 62.0))
    with pytest.raises(ValueError, match="while the voltage moves"):
        played_segments(moved)
