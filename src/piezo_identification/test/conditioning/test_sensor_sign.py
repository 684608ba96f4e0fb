# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from piezo_identification.conditioning.sensor_sign import displacement_falls, moves_against
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_sign_is_found_in_a_recording_with_a_gap(sign):
    sample = np.concatenate([np.arange(300), np.arange(900, 1500)])
    voltage_v = 50.0 - 50.0 * np.cos(2.0 * np.pi * sample / 200)
    recording = Recording(
        "with a gap", 100.0, sample, np.full(sample.size, 0.01), voltage_v,
        sign * 0.2 * voltage_v, np.full(sample.size, Flag.PLAYING, dtype=np.uint32),
        gaps=[(300, 600)])
    assert displacement_falls(recording) == (sign < 0.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_motion_beyond_a_resonance_does_not_turn_the_sign(sign):
    draw, period_s = np.random.default_rng(4), 1e-3
    given = draw.normal(size=40_000)
    moved = np.zeros(given.size)
    w, damping = 2.0 * np.pi * 40.0, 0.02
    speed = 0.0
    for n in range(given.size - 1):
        speed += period_s * (w * w * (given[n] - moved[n]) - 2.0 * damping * w * speed)
        moved[n + 1] = moved[n] + period_s * speed
    late = np.roll(moved, 2)
    assert np.corrcoef(given, late)[0, 1] < 0.0
    assert moves_against(sign * late, given) == (sign < 0.0)


def test_step_that_overshoots_does_not_turn_the_sign():
    time_s = 2e-3 * np.arange(2000)
    since_s = np.maximum(time_s - 0.1, 0.0)
    moved = 1.0 - np.exp(-20.0 * since_s)
    overshooting = moved * (0.65 + 0.6 * np.exp(-3.0 * since_s))
    assert not moves_against(moved, overshooting)
    assert moves_against(-moved, overshooting)
