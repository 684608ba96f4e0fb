# SPDX-License-Identifier: BSD-3-Clause
"""Paths in Python: the example runs, and what an identified model is to do is what it does."""

import doctest

import numpy as np
import pytest
from scipy.signal import lfilter

import piezo_offline
from piezo_controller.axes import scan as scan_module
from piezo_models import save_axes_model

GAIN = np.array([[0.2, 0.006], [-0.005, 0.15]])
NOISE_UM = 0.01


def moved_um(voltage_v):
    """Return what two lagged axes with static coupling do from rest."""
    return lfilter([0.0, 0.4], [1.0, -0.6], voltage_v @ GAIN.T, axis=0)


@pytest.fixture(scope="module")
def identified():
    recordings = []
    for seed in (1, 2):
        rng = np.random.default_rng(seed)
        drive = 5.0 * rng.normal(size=(1500, 2)) * (np.arange(1500)[:, None] > 20)
        measured = moved_um(drive) + NOISE_UM * rng.normal(size=drive.shape)
        recordings.append({
            "time_s": 1e-3 * np.arange(1500), "x_voltage_v": drive[:, 0],
            "y_voltage_v": drive[:, 1], "x_displacement_um": measured[:, 0],
            "y_displacement_um": measured[:, 1]})
    return piezo_offline.identify(dynamics=recordings, modes=1)


def test_the_example_runs():
    assert doctest.testmod(scan_module, optionflags=doctest.NORMALIZE_WHITESPACE).failed == 0


def test_an_identified_model_leaves_the_error_that_its_deviations_lead_one_to_expect(
        identified, tmp_path):
    plan = piezo_offline.scan(identified, "spiral", size_um=(2, 2), rate_hz=10.0, lines=5)
    done = moved_um(np.concatenate([plan.begin_voltage_v, *[plan.voltage_v] * 3]))
    left_um = done[-len(plan.voltage_v):] - plan.path.position_um
    left = 100.0 * np.sqrt(np.mean(left_um**2, axis=0)) / np.ptp(plan.path.position_um, axis=0)
    expected = plan.prediction.error_percent["uncertain"]
    assert plan.prediction.error_percent["coupled"].max() < 0.1 * expected.min()
    assert np.all(left < 3.0 * expected)
    assert np.any(left > expected / 10.0)
    save_axes_model(tmp_path / "model.json", identified)
    again = piezo_offline.scan(tmp_path / "model.json", plan.path)
    np.testing.assert_allclose(again.voltage_v, plan.voltage_v, rtol=1e-6, atol=1e-6)
