# SPDX-License-Identifier: BSD-3-Clause
"""Signs and rows that are the logger's, in recordings that SciPy alone has made."""

from dataclasses import replace

import numpy as np
import pytest
from made_by_scipy import behind_mode, line_model, logged

from piezo_identification.conditioning.settling import low_frequency_delay_s
from piezo_identification.diagnosis.diagnose import condition, diagnose
from piezo_identification.diagnosis.evidence.recording_faults import (
    without_faults,
)
from piezo_identification.diagnosis.report.diagnosis_report import render_report
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics

PERIOD_S = 1e-3
MODE_RAD_PER_S, DAMPING_RATIO = 400.0, 0.05
NOISE_UM = 2e-3


@pytest.fixture(scope="module")
def model():
    return line_model(MODE_RAD_PER_S, DAMPING_RATIO)


def voltages(kind, samples=9000):
    random = np.random.default_rng(4)
    time_s = PERIOD_S * np.arange(samples)
    if kind == "levels":
        return np.repeat(random.uniform(-50.0, 50.0, samples // 60), 60)
    if kind == "sine":
        return 40.0 * np.sin(2.0 * np.pi * 3.1 * time_s)
    noise = np.convolve(random.normal(size=samples), np.hanning(60), mode="same")
    return 50.0 * noise / np.abs(noise).max()


def answered(voltage_v, period_s=PERIOD_S, delay_s=0.0):
    """A mass on a spring, sampled at the instants of the rows; the voltage is held, (N,)."""
    fine = 20
    step_s = period_s / fine
    held_v = np.repeat(voltage_v, fine)
    late = round(delay_s / step_s)
    held_v = np.concatenate([np.full(late, held_v[0]), held_v[: held_v.size - late]])
    moved_um = behind_mode(0.1 * (held_v - held_v[0]), MODE_RAD_PER_S, DAMPING_RATIO, step_s)
    return moved_um[::fine] + 0.1 * held_v[0]


def recorded(voltage_v, displacement_um, period_s=PERIOD_S):
    noise = np.random.default_rng(7).normal(scale=NOISE_UM, size=voltage_v.size)
    return logged(voltage_v, displacement_um + noise, period_s)


def shifted(displacement_um, rows):
    if rows > 0:
        return np.concatenate([np.full(rows, displacement_um[0]), displacement_um[:-rows]])
    return np.concatenate([displacement_um[-rows:], np.full(-rows, displacement_um[-1])])


@pytest.mark.parametrize("kind", ["levels", "sine", "noise"])
@pytest.mark.parametrize("rows", [1, 3, -2, -60])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_rows_that_are_misaligned_are_named_with_their_count(model, kind, rows, sign):
    voltage_v = voltages(kind)
    given = recorded(voltage_v, sign * shifted(answered(voltage_v), rows))
    usable, faults = without_faults(model, given)
    assert {fault.name for fault in faults} == {"misaligned_rows"} | (
        {"wrong_sign"} if sign < 0.0 else set())
    found = next(fault for fault in faults if fault.name == "misaligned_rows")
    assert found.numbers["rows"] == rows
    assert found.numbers["after_rms_um"] < 1.3 * NOISE_UM < found.numbers["before_rms_um"]
    late = max(rows, 0)
    index = np.arange(500, 5000)
    np.testing.assert_allclose(usable.displacement_um[index],
                               sign * given.displacement_um[index + (late if rows > 0 else 0)]
                               if rows > 0 else sign * given.displacement_um[index])


@pytest.mark.parametrize("kind", ["levels", "sine", "noise"])
@pytest.mark.parametrize(("change", "delay_s"), [
    ("nothing", 0.0), ("delay", 4e-4), ("drift", 0.0), ("curve", 0.0), ("stranger", 0.0)])
def test_what_is_no_fault_of_the_rows_is_not_named(model, kind, change, delay_s):
    voltage_v = voltages(kind)
    displacement_um = answered(voltage_v, delay_s=delay_s)
    if change == "drift":
        displacement_um = displacement_um + np.linspace(0.0, 3.0, voltage_v.size)
    elif change == "curve":
        displacement_um = displacement_um - 0.004 * displacement_um**3
    elif change == "stranger":
        displacement_um = np.cumsum(np.random.default_rng(1).normal(size=voltage_v.size)) * 0.02
    _, faults = without_faults(model, recorded(voltage_v, displacement_um))
    assert "misaligned_rows" not in {fault.name for fault in faults}


@pytest.mark.parametrize("samples", [20, 200, 400])
def test_a_recording_that_the_model_answers_exactly_has_no_fault(samples):
    line = StageModel(
        PreisachModel.line(0.0, 100.0, 0.4), CreepDynamics(), ElectricVibrationDynamics())
    voltage_v = 50.0 - 50.0 * np.cos(0.006 * np.arange(samples))
    exact = replace(recorded(voltage_v, 0.0), displacement_um=line.simulate(voltage_v, PERIOD_S))
    assert without_faults(line, exact)[1] == []


def test_a_delay_of_whole_rows_of_a_fast_recording_is_the_stages(model):
    period_s = 1e-4
    voltage_v = voltages("levels")
    late = recorded(voltage_v, answered(voltage_v, period_s, 2.0 * period_s), period_s)
    assert without_faults(model, late)[1] == []
    # What comes before its cause is no stage's, however fast the recording.
    early = recorded(voltage_v, shifted(answered(voltage_v, period_s), -2), period_s)
    assert [fault.numbers["rows"] for fault in without_faults(model, early)[1]] == [-2]
    # A mode with little damping hardly delays, but its ringing shows the delay.
    period_s, voltage_v = 6e-4, voltages("noise")
    moved_um = behind_mode(0.1 * voltage_v, MODE_RAD_PER_S, 0.02, period_s)
    light = line_model(MODE_RAD_PER_S, 0.02)
    assert without_faults(light, recorded(voltage_v, shifted(moved_um, 4), period_s))[1] == []


@pytest.mark.long
def test_a_logger_with_both_faults_lacks_nothing(model):
    voltage_v = voltages("noise")
    given = recorded(voltage_v, -shifted(answered(voltage_v), 2))
    holdout = recorded(voltage_v[::-1].copy(), answered(voltage_v[::-1].copy()))
    diagnosis = diagnose(model, [given], holdout)
    assert (diagnosis.verdict, diagnosis.effects) == ("none", [])
    told = diagnosis.document()["recording_faults"]
    assert [fault["name"] for fault in told] == ["wrong_sign", "misaligned_rows"]
    assert all(fault["recording"] == "logged" and fault["remedy"] for fault in told)
    assert diagnosis.reversed == ["logged"]
    page = render_report(diagnosis)
    assert "misaligned_rows: logged: the displacement stands 2 rows after" in page
    assert "wrong_sign: logged: the displacement moves against the model" in page


def test_conditioned_recordings_tell_their_faults(model):
    voltage_v = voltages("levels")
    down = recorded(voltage_v, -answered(voltage_v))
    given = condition(model, [replace(down, path="down")], None)
    assert [(fault.name, fault.recording) for fault in given.faults] == [("wrong_sign", "down")]


def test_the_group_delay_is_the_slope_of_the_phase():
    dynamics = ElectricVibrationDynamics(3e-4, (900.0, 2500.0), (0.2, 0.05), (1700.0,), (0.1,))
    slow_rad_per_s = 1e-3
    phase = np.angle(dynamics.state_space()(1j * slow_rad_per_s))
    assert low_frequency_delay_s(dynamics) == pytest.approx(-phase / slow_rad_per_s, rel=1e-6)
