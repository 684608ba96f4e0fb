# SPDX-License-Identifier: BSD-3-Clause
"""Hysteresis and creep of each axis in front of shared modes, from slow and fast recordings."""

import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from piezo_identification.axes import actuator_estimate, actuator_start, amplifier_lags
from piezo_identification.axes.identify_axes import identify_several_axes
from piezo_identification.axes.predict_axes import predict_several_axes
from piezo_models.axes_model_file import load_axes_model, save_axes_model
from piezo_models.effects.bouc_wen_hysteresis import BoucWenHysteresis

sys.path.insert(0, str(Path(__file__).parent))
import flexure
import scanner


@pytest.fixture(scope="module", autouse=True)
def few_levels():
    """Plays explain most of the loops: the cells beside them may be wide.

    The second estimate of the loops, and lags and loops that drift, which this stage does not have,
    are for `make long` alone.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(actuator_start, "LEVELS", (6, 12))
        if "LONG_TESTS" not in os.environ:
            patch.setattr(actuator_start, "LEVELS", (10,))
            patch.setattr(amplifier_lags, "SWEEPS", 0)
            patch.setattr(actuator_estimate, "is_at_noise", lambda *_: True)
        yield


@pytest.fixture(scope="module")
def identified():
    tables = scanner.experiments(np.random.default_rng(1), samples=3072,
                                 loop_samples=12_000, step_samples=60_000)
    return identify_several_axes(**{
        experiment: [flexure.recording(table, f"{experiment} {number}")
                     for number, table in enumerate(listed)]
        for experiment, listed in tables.items()}, pairs=len(flexure.FREQUENCY_RAD_PER_S))


def slow_v(samples):
    time_s = flexure.PERIOD_S * np.arange(samples)
    swing = 35.0 * np.sin(4.0 * np.pi * time_s - np.pi / 2.0) + 15.0 * np.sin(10.0 * np.pi * time_s)
    return np.column_stack([swing - swing[0] + 14.0,
                            5.0 + np.abs(60.0 * np.sin(2.2 * np.pi * time_s))])


def fast_v(samples):
    rng = np.random.default_rng(5)
    return 50.0 + np.column_stack([flexure.multisine_v(samples, rng, 8.0) for _ in range(2)])


@pytest.mark.parametrize("unseen_v", [slow_v(10_000), fast_v(3000)], ids=["slow", "fast"])
def test_unseen_motion_is_predicted_to_three_times_the_noise(identified, unseen_v):
    table = scanner.table(unseen_v, np.random.default_rng(9))
    prediction = predict_several_axes(identified.model, flexure.recording(table, "unseen"))
    left_um = prediction.measured_um - prediction.simulated_um
    assert np.all(np.std(left_um, axis=0) < 3.0 * flexure.NOISE_UM)


def test_every_entry_of_the_coupling_is_found(identified):
    low_v, high_v = identified.voltage_range_v[0]
    turn_v = np.concatenate([np.linspace(low_v, high_v, 500), np.linspace(high_v, low_v, 500)])
    rises_v = [np.ptp(scanner.passed_v(turn_v, axis)) / (high_v - low_v) for axis in range(2)]
    coupling = identified.coupling
    driven = coupling.frequency_hz < 2500.0
    true = (flexure.response(coupling.frequency_hz) * rises_v)[driven]
    error = np.abs(coupling.gain_um_per_v[driven] - true)
    deviation = np.abs(coupling.deviation_um_per_v[driven])
    assert np.all(error < np.maximum(0.1 * np.abs(true), 3.0 * 1.6449 * deviation))
    low, high = (each[driven] for each in coupling.interval_90())
    within = np.concatenate([(low.real <= true.real) & (true.real <= high.real),
                             (low.imag <= true.imag) & (true.imag <= high.imag)])
    assert np.mean(within[:, [0, 1], [1, 0]]) > 0.75, "between the axes"


def test_the_modes_are_found(identified):
    found = np.sort(np.abs(identified.model.poles_rad_per_s))
    np.testing.assert_allclose(found, flexure.FREQUENCY_RAD_PER_S, rtol=1e-3)


def test_the_creep_of_each_axis_is_found(identified):
    # What creeps within 0.1 s does so on every way of the loops, as if it were hysteresis.
    after_s = np.array([[0.1], [2.0]])
    for actuator, lasting_s, parts in zip(identified.model.actuators, scanner.CREEP_S,
                                          scanner.CREEP, strict=True):
        rates = np.array(actuator.creep.poles_rad_per_s)
        found = np.diff((1.0 - np.exp(-after_s * rates)) @ actuator.creep_gains)
        true = np.diff((1.0 - np.exp(-after_s / lasting_s)) @ parts)
        np.testing.assert_allclose(found, true, rtol=0.1)


@pytest.mark.long
def test_where_no_hysteresis_is_shown_none_is_added():
    rng = np.random.default_rng(3)
    loops = flexure.recording(
        flexure.table(scanner.along(0, scanner.loops_v(800)), rng), "loops")
    fast = [flexure.recording(table, f"fast {number}")
            for number, table in enumerate(flexure.experiments(512))]
    model = identify_several_axes(
        fast, hysteresis=[loops], pairs=len(flexure.FREQUENCY_RAD_PER_S)).model
    assert not model.actuators


def test_a_saved_model_predicts_alike(identified, tmp_path):
    first, *others = identified.model.actuators
    model = replace(identified.model, actuators=(
        replace(first, lag_s=2e-4, bouc_wen=BoucWenHysteresis(3.0, 15.0)), *others))
    save_axes_model(tmp_path / "model.json", replace(identified, model=model))
    again, voltage_v = load_axes_model(tmp_path / "model.json"), slow_v(1000)
    np.testing.assert_allclose(again.model.simulate(voltage_v), model.simulate(voltage_v),
                               rtol=1e-9)
    assert "amplifier lag of x" in repr(again.summary())
    assert "saturation_v of x" in repr(again.summary())
