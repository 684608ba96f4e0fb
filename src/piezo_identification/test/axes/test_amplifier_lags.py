# SPDX-License-Identifier: BSD-3-Clause
"""The lag of the amplifier in front of the hysteresis of an axis."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from piezo_identification.axes.amplifier_lags import with_amplifier_lags
from piezo_identification.axes.modal_model import modal_model
from piezo_models.axes.actuator import Actuator
from piezo_recorder.reading.axes import AxesRecording

sys.path.insert(0, str(Path(__file__).parent))
from test_whole_axes_fit import NUMBERS, PERIOD_S, TRUE, actuator

LAG_S, NOISE_UM, FINER = 2e-4, 1e-4, 20
PROMPT = replace(TRUE, actuators=(actuator(0), actuator(1)))
LIGHT = np.exp(PERIOD_S * np.array([-6.0 + 1900.0j, -9.0 + 2800.0j]))
"""Of the modes of a stage whose errors are almost all at its resonances."""


def fast_v(seed, samples=1000):
    rng = np.random.default_rng(seed)
    voltage_v = 50.0 + 20.0 * np.column_stack([
        np.sin(np.cumsum(rng.uniform(0.0, 1.5, samples))) for _ in range(2)])
    voltage_v[:50] = voltage_v[0]
    return voltage_v


def followed_v(voltage_v, lag_s=LAG_S):
    """Return what the amplifier puts out at the ends of the samples, by finer steps."""
    kept = np.exp(-PERIOD_S / FINER / lag_s)
    fine_v, _ = lfilter([1.0 - kept], [1.0, -kept], np.repeat(voltage_v, FINER),
                        zi=[kept * voltage_v[0]])
    return fine_v[FINER - 1::FINER]


def recordings(stage=PROMPT, lag_s=LAG_S):
    """Return recordings in which the hysteresis of x follows a lagging voltage, and moves modes."""
    found = []
    for seed in range(2):
        voltage_v = fast_v(seed)
        drive_v = PROMPT.drive_v(voltage_v)
        drive_v[:, 0] = PROMPT.actuators[0].drive_v(
            followed_v(voltage_v[:, 0], lag_s), PERIOD_S)
        displacement_um = replace(stage, actuators=()).simulate(drive_v)
        displacement_um += NOISE_UM * np.random.default_rng(9 + seed).normal(size=drive_v.shape)
        found.append(AxesRecording(f"fast {seed}", ("x", "y"), PERIOD_S, voltage_v,
                                   displacement_um))
    return found


def test_lag_in_front_of_the_hysteresis_is_found_on_the_axis_that_has_one():
    found = with_amplifier_lags(PROMPT, NUMBERS.steps, recordings())
    assert found.actuators[0].lag_s == pytest.approx(LAG_S, rel=0.1)
    assert found.actuators[1].lag_s == 0.0


@pytest.mark.parametrize(("lag_s", "found_s"), [(3e-5, 3e-5), (1.9e-5, 0.0)])
def test_lag_shorter_than_a_sample_is_found_unless_it_settles_within_it(lag_s, found_s):
    numbers = replace(NUMBERS, steps=LIGHT, gains=NUMBERS.gains[:4])
    light = modal_model(numbers, TRUE.latency_samples, TRUE.axes, PERIOD_S)
    light = replace(light, actuators=PROMPT.actuators)
    found = with_amplifier_lags(light, LIGHT, recordings(light, lag_s)[:1])
    assert found.actuators[0].lag_s == pytest.approx(found_s, rel=0.1)
    assert found.actuators[1].lag_s == 0.0


def test_drive_of_a_lagging_actuator_moves_the_lag_as_a_hysteresis_of_the_lagging_voltage():
    voltage_v, kept = fast_v(3)[:, 0], np.exp(-PERIOD_S / LAG_S)
    bare = Actuator(PROMPT.actuators[0].hysteresis)
    drive_v = replace(bare, lag_s=LAG_S).drive_v(voltage_v, PERIOD_S)
    behind_v, _ = lfilter([1.0 - kept], [1.0, -kept], drive_v, zi=[kept * drive_v[0]])
    np.testing.assert_allclose(behind_v, bare.drive_v(followed_v(voltage_v), PERIOD_S), atol=1e-9)


def test_inverse_of_a_lagging_actuator_gives_the_voltage():
    lagging = replace(PROMPT.actuators[0], lag_s=LAG_S)
    phase = 2.0 * np.pi * np.arange(400) / 400
    voltage_v = 50.0 + 30.0 * np.sin(phase) + 3.0 * np.sin(5.0 * phase)
    drive_v = lagging.drive_v(voltage_v, PERIOD_S, periodic=True)
    np.testing.assert_allclose(lagging.inverse_v(drive_v, PERIOD_S), voltage_v, atol=1e-9)
