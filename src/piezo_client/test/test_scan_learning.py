# SPDX-License-Identifier: BSD-3-Clause
"""What repeats of an error is taken off, as far as the stage passes it."""

import dataclasses
from pathlib import Path

import control
import numpy as np
import pytest

from piezo_client.scan_learning import learned
from piezo_client.scans import Scanned
from piezo_controller.axes.stored_scan import StoredScan, read_scan, write_scan
from piezo_models.axes.coupled import CoupledModel

PERIOD_S, SAMPLES, BEGIN = 1e-3, 400, 60
PHASE = 2.0 * np.pi * np.arange(SAMPLES) / SAMPLES


def stage_of(gain=1.0, frequency_hz=60.0):
    """Return two coupled axes behind a mode that both share."""
    s, w = control.tf("s"), 2.0 * np.pi * frequency_hz
    mode = control.ss(w**2 / (s**2 + 0.2 * w * s + w**2))
    push = gain * np.array([[0.2, 0.01], [-0.01, 0.2]])
    return CoupledModel.from_control(control.sample_system(
        control.append(mode, mode) * control.ss([], [], [], push), PERIOD_S), ("x", "y"))


def followed(stage, scan, noise_um=0.0):
    """Return the last period of a run, with what a nonlinear stage would add."""
    displacement_um = stage.simulate(scan.voltage_v, periodic=True)
    displacement_um = displacement_um + 0.02 * displacement_um**2
    return Scanned(Path("run"), scan, displacement_um + noise_um)


@pytest.fixture
def scan():
    position_um = np.column_stack([np.cos(PHASE), np.sin(2.0 * PHASE)])
    return StoredScan(("x", "y"), PERIOD_S, np.zeros((BEGIN, 2)), 5.0 * position_um, position_um)


def test_error_that_repeats_falls_run_by_run_though_the_model_is_off(scan):
    stage, model = stage_of(), stage_of(gain=1.15, frequency_hz=62.0)
    errors = []
    for _ in range(6):
        run = followed(stage, scan)
        errors.append(max(run.error_percent))
        scan = learned(run, model)
    assert errors[0] > 1.0 and errors[-1] < 0.01
    assert all(np.diff(errors) < 0.0)


def test_what_the_stage_does_not_pass_is_not_learned(scan):
    model = stage_of()
    high = np.cos(180 * PHASE)[:, None] * [0.1, 0.0]  # 450 Hz, far above the mode
    run = Scanned(Path("run"), scan, scan.position_um + high)
    assert np.allclose(learned(run, model).voltage_v, scan.voltage_v, atol=1e-9)


def test_offset_is_left_and_the_way_into_the_path_ends_where_it_begins(scan):
    run = followed(stage_of(), scan, noise_um=[0.3, -0.1])
    shifted, still = learned(run, stage_of()), learned(followed(stage_of(), scan), stage_of())
    assert np.allclose(shifted.voltage_v, still.voltage_v)
    more_v = shifted.voltage_v - scan.voltage_v
    assert np.allclose(shifted.begin_voltage_v[0], 0.0)
    assert np.allclose(shifted.begin_voltage_v[-1], more_v[-1], rtol=1e-3, atol=1e-5)


def test_model_of_another_clock_or_other_axes_is_refused(scan):
    run = followed(stage_of(), scan)
    with pytest.raises(ValueError, match="the axes x, y at 1000 Hz, the scan x, y at 1"):
        learned(dataclasses.replace(run, scan=dataclasses.replace(
            scan, sample_period_s=1e-4)), stage_of())
    with pytest.raises(ValueError, match="the scan a, b at 1000 Hz: give the model that it was"):
        learned(dataclasses.replace(run, scan=dataclasses.replace(scan, axes=("a", "b"))),
                stage_of())


def test_learned_voltages_are_written_as_a_planned_path_is(scan, tmp_path):
    write_scan(scan, tmp_path / "learned")
    read = read_scan(tmp_path / "learned")
    assert read.axes == scan.axes and read.sample_period_s == PERIOD_S
    for name in ("voltage_v", "position_um", "begin_voltage_v"):
        assert np.allclose(getattr(read, name), getattr(scan, name), rtol=1e-8, atol=1e-8)
