# SPDX-License-Identifier: BSD-3-Clause
"""Properties of voltages."""

import numpy as np
import pytest

from piezo_identification.conditioning.waveforms import has_holds
from piezo_recorder import recording_of

TIME_S = 0.1 * np.arange(4000)
NOISE_V = 0.02 * np.random.default_rng(1).normal(size=TIME_S.size)


@pytest.mark.parametrize("voltage_v, expected", [
    (20.0 * np.floor(TIME_S / 80.0), True),
    (np.where(TIME_S % 100.0 < 50.0, 0.0, 90.0) + NOISE_V, True),
    (np.interp(TIME_S % 130.0, [0.0, 10.0, 60.0, 70.0, 130.0], [0.0, 80.0, 80.0, 0.0, 0.0]), True),
    (np.interp(TIME_S, [0.0, 200.0, 400.0], [0.0, 90.0, 0.0]), False),
    (45.0 - 45.0 * np.cos(0.05 * TIME_S) + NOISE_V, False),
    (np.random.default_rng(2).uniform(0.0, 90.0, TIME_S.size), False)])
def test_holds_are_levels_for_much_of_the_time(voltage_v, expected):
    assert has_holds(recording_of({
        "time_s": TIME_S, "voltage_v": voltage_v, "displacement_um": voltage_v})) is expected
