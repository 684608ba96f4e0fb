# SPDX-License-Identifier: BSD-3-Clause
"""Effects that came later are named with their axis, and the extended model predicts with them."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from piezo_identification.axes.axis_effects import AxisEffect
from piezo_identification.axes.diagnose_axes import diagnose_axes
from piezo_identification.axes.identify_axes import identify_several_axes
from piezo_identification.axes.predict_axes import predict_several_axes
from piezo_identification.commands.diagnose_command import main
from piezo_models.axes.coupled import NEAR
from piezo_models.axes_model_file import load_axes_model, save_axes_model
from piezo_recorder.reading.recording import RecordingError

sys.path.insert(0, str(Path(__file__).parent))
import flexure

SAMPLES = 3000
CROSSTALK = 0.02


@pytest.fixture(scope="module")
def identified():
    *alone, both = (flexure.recording(table, f"table {number}") for number, table in
                    enumerate(flexure.experiments(samples=2048)))
    return identify_several_axes(
        alone, [both], pairs=len(flexure.FREQUENCY_RAD_PER_S))


def fast_v(rng):
    return np.column_stack([flexure.multisine_v(SAMPLES, rng) for _ in range(2)])


def slow_v():
    time_s = flexure.PERIOD_S * np.arange(SAMPLES)
    return 10.0 * np.sin(2.0 * np.pi * np.outer(time_s, [7.0, 11.0]))


def recorded(voltage_v, rng, driven=((1, 0), (0, 1)), seen=((1, 0), (0, 1)), added_um=0.0):
    """Return a recording of the flexure with voltages and readings mixed."""
    columns = flexure.table(voltage_v, rng)
    measured = flexure.motion_um(voltage_v @ np.transpose(driven)) @ np.transpose(seen) + added_um
    measured += flexure.NOISE_UM * rng.normal(size=measured.shape)
    return flexure.recording({**columns, "x_displacement_um": measured[:, 0] + 10.0,
                              "y_displacement_um": measured[:, 1] + 7.0}, "changed")


def mode_um(voltage_v, frequency_rad_per_s, damping_ratio, *gains_um_per_v):
    """Return what the late sensors see of a mode, (N, 2), simulated at finer steps."""
    finer = 10
    mode = cont2discrete(([frequency_rad_per_s**2], [
        1.0, 2.0 * damping_ratio * frequency_rad_per_s, frequency_rad_per_s**2]),
        flexure.PERIOD_S / finer)
    moved = lfilter(mode[0][0], mode[1], np.repeat(voltage_v, finer))
    late = [round(finer * each) for each in flexure.LATE]
    return np.column_stack([gain * np.pad(moved, (samples, 0))[:moved.size:finer]
                            for gain, samples in zip(gains_um_per_v, late, strict=True)])


CASES = {
    "gain[x]": (0.01, {}, {"seen": ((1.01, 0), (0, 1))}),
    "gain[y]": (-0.02, {}, {"seen": ((1, 0), (0, 0.98))}),
    "squareness[y,x]": (0.01, {"OUT_OF_SQUARE_RAD": flexure.OUT_OF_SQUARE_RAD + 0.01}, {}),
    "cross_coupling[x,y]": (CROSSTALK * flexure.STATIC_UM_PER_V[0, 0], {},
                            {"driven": ((1, CROSSTALK), (0, 1))}),
    "cross_coupling[y,x]": (-CROSSTALK * flexure.STATIC_UM_PER_V[1, 1], {},
                            {"driven": ((1, 0), (-CROSSTALK, 1))}),
    "delay[x]": (3.3e-4, {"LATE": (3.6, 1.6)}, {}),
    "delay[y]": (5e-5, {"LATE": (0.3, 2.1)}, {})}
SHOWN_ELSEWHERE = ("gain[x]", "delay[y]", "cross_coupling[x,y]")
"""By the command, by two effects together, and of a frequency response."""
OF_THE_OTHER_AXIS = ("gain[y]", "cross_coupling[y,x]", "delay[x]")


def label(entry):
    where = [entry["parameters"][key] for key in ("axis", "from_axis")
             if key in entry["parameters"]]
    return f"{entry['name']}[{','.join(where)}]"


@pytest.mark.parametrize("name", [
    pytest.param(name, marks=[pytest.mark.long] * (name in OF_THE_OTHER_AXIS + SHOWN_ELSEWHERE))
    for name in CASES])
def test_effect_is_named_with_its_axis_and_the_extended_model_predicts(
        identified, monkeypatch, name):
    value, stage, recording = CASES[name]
    for constant, changed in stage.items():
        monkeypatch.setattr(flexure, constant, changed)
    rng = np.random.default_rng(3)
    diagnosed = recorded(fast_v(rng), rng, **recording)
    diagnosis = diagnose_axes(identified, diagnosed)
    assert diagnosis.verdict == "explained"
    effect, = diagnosis.effects
    assert label(effect) == name
    (parameter, off), = effect["standard_deviations"].items()
    assert abs(effect["parameters"][parameter] - value) < 3.0 * off < abs(value)
    prediction = predict_several_axes(diagnosis.extended.model, diagnosed)
    assert prediction.e_y_percent() == {
        axis: error["e_y_percent"] for axis, error in diagnosis.after.items()}
    second = predict_several_axes(
        diagnosis.extended.model, recorded(fast_v(rng), rng, **recording))
    assert np.all(np.std(second.measured_um - second.simulated_um, axis=0) < 2 * flexure.NOISE_UM)


@pytest.mark.parametrize(("axis", "frequency_hz"), [
    ("x", 520.0), pytest.param("y", 1400.0, marks=pytest.mark.long)])
def test_mode_that_one_axis_drives_is_named_with_it(identified, tmp_path, axis, frequency_hz):
    rng = np.random.default_rng(9)
    values = (2.0 * np.pi * frequency_hz, 0.01, 0.004, -0.002)
    number = identified.model.axes.index(axis)
    diagnosed, second = (recorded(voltage_v, rng, added_um=mode_um(voltage_v[:, number], *values))
                         for voltage_v in (fast_v(rng), fast_v(rng)))
    diagnosis = diagnose_axes(identified, diagnosed)
    assert diagnosis.verdict == "explained"
    effect, = diagnosis.effects
    assert label(effect) == f"vibration_mode[{axis}]"
    for value, (name, off) in zip(values, effect["standard_deviations"].items(), strict=True):
        assert abs(effect["parameters"][name] - value) < 3.0 * off < abs(value)
    diagnosis.write(tmp_path)
    extended = load_axes_model(tmp_path / "extended_model.json")
    prediction = predict_several_axes(extended.model, second)
    assert np.all(np.std(prediction.measured_um - prediction.simulated_um, axis=0)
                  < 2 * flexure.NOISE_UM)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(20))
def test_drawn_mode_is_named_or_nothing_is_where_it_overlaps_with_a_known_one(identified, seed):
    rng = np.random.default_rng(seed)
    axis, frequency, damping = int(rng.integers(2)), *np.exp(rng.uniform(
        np.log([2.0 * np.pi * 60.0, 0.005]), np.log([2.0 * np.pi * 2500.0, 0.05])))
    gains = rng.uniform(0.001, 0.01, 2) * rng.choice([-1.0, 1.0], 2)
    voltage_v = fast_v(rng)
    diagnosis = diagnose_axes(identified, recorded(voltage_v, rng, added_um=mode_um(
        voltage_v[:, axis], frequency, damping, *gains)))
    known = flexure.FREQUENCY_RAD_PER_S
    overlap = damping * frequency + (flexure.DAMPING + NEAR) * known
    if np.any(np.abs(frequency - known) < overlap):
        assert diagnosis.verdict == "unexplained"
    else:
        effect, = diagnosis.effects
        assert label(effect) == f"vibration_mode[{'xy'[axis]}]"
        off = effect["standard_deviations"]["frequency_rad_per_s"]
        assert abs(effect["parameters"]["frequency_rad_per_s"] - frequency) < 4.0 * off


def test_two_effects_are_named_together(identified, monkeypatch):
    monkeypatch.setattr(flexure, "LATE", (0.5, 1.6))
    rng = np.random.default_rng(4)
    diagnosis = diagnose_axes(identified, recorded(fast_v(rng), rng, seen=((1, 0), (0, 0.98))))
    assert diagnosis.verdict == "explained"
    assert {label(each) for each in diagnosis.effects} == {"delay[x]", "gain[y]"}
    assert "delay[x]" in repr(diagnosis)


@pytest.mark.parametrize("seed", [
    0, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 2))])
@pytest.mark.parametrize("kind", ["fast", pytest.param("slow", marks=pytest.mark.long)])
def test_nothing_is_named_on_an_unchanged_stage(identified, seed, kind):
    rng = np.random.default_rng(seed)
    voltage_v = fast_v(rng) if kind == "fast" else slow_v()
    diagnosis = diagnose_axes(identified, recorded(voltage_v, rng))
    assert (diagnosis.verdict, diagnosis.effects) == ("none", [])
    assert diagnosis.probabilities["none"] > 0.5
    assert diagnosis.after == diagnosis.before


def test_slow_motion_does_not_distinguish_crosstalk_from_a_turned_sensor(identified):
    rng = np.random.default_rng(5)
    diagnosis = diagnose_axes(identified, recorded(
        0.3 * slow_v(), rng, driven=((1, CROSSTALK), (0, 1))))
    alike = {"cross_coupling[x,y]", "squareness[x,y]"}
    named, = diagnosis.effects
    assert diagnosis.confounded_with == {(alike - {label(named)}).pop(): label(named)}
    assert sum(diagnosis.probabilities[each] for each in alike) > 0.95


def test_motion_of_another_cause_is_unexplained(identified):
    rng = np.random.default_rng(6)
    shaken_um = 0.1 * np.sin(0.3 * np.arange(SAMPLES))[:, None] * [1.0, 0.0]
    diagnosis = diagnose_axes(identified, recorded(fast_v(rng), rng, added_um=shaken_um))
    assert (diagnosis.verdict, diagnosis.effects) == ("unexplained", [])
    assert "x: 0.07" in diagnosis.left


def test_delays_of_parts_of_a_sample_add_up(identified):
    model, late, period_s = identified.model, AxisEffect("delay", "y"), flexure.PERIOD_S
    twice = late.applied(late.applied(replace(model, direct_um_per_v=0.0 * model.direct_um_per_v),
                                      np.array([0.3 * period_s])), np.array([1.7 * period_s]))
    frequency_hz = np.array([1.0, 50.0, 310.0, 1000.0])
    shift = np.exp(-2j * np.pi * frequency_hz * 2.0 * period_s)
    once = replace(model, direct_um_per_v=0.0 * model.direct_um_per_v).response(frequency_hz)
    np.testing.assert_allclose(twice.response(frequency_hz)[:, 1], shift[:, None] * once[:, 1],
                               rtol=0.0, atol=0.01 * np.abs(once).max())
    np.testing.assert_allclose(twice.response(frequency_hz)[:, 0], once[:, 0])


def test_recordings_that_show_nothing_are_refused(identified):
    rng = np.random.default_rng(7)
    recording = recorded(fast_v(rng), rng)
    with pytest.raises(RecordingError, match="moves: give a recording of motion"):
        diagnose_axes(identified, replace(recording, voltage_v=0.0 * recording.voltage_v))
    with pytest.raises(RecordingError, match="the displacement of x in .* is constant"):
        diagnose_axes(identified, replace(
            recording, displacement_um=recording.displacement_um * [0.0, 1.0]))
    with pytest.raises(RecordingError, match="100 rows: give 360 or more"):
        diagnose_axes(identified, replace(recording, voltage_v=recording.voltage_v[:100],
                                          displacement_um=recording.displacement_um[:100]))


def test_command_writes_verdict_and_extended_model(identified, tmp_path, capsys):
    rng = np.random.default_rng(8)
    model, table = tmp_path / "model.json", tmp_path / "late.csv"
    save_axes_model(model, identified)
    recording = recorded(fast_v(rng), rng, seen=((1.03, 0), (0, 1)))
    np.savetxt(table, np.column_stack([
        flexure.PERIOD_S * np.arange(SAMPLES), recording.voltage_v, recording.displacement_um]),
        delimiter=",", comments="",
        header="time_s,x_voltage_v,y_voltage_v,x_displacement_um,y_displacement_um")
    given = ["--model", str(model), "--data", str(table), "--output", str(tmp_path / "out")]
    assert main(given) == 0
    assert "verdict: explained" in capsys.readouterr().out
    verdict = json.loads((tmp_path / "out" / "verdict.json").read_text())
    assert [label(each) for each in verdict["effects"]] == ["gain[x]"]
    extended = load_axes_model(tmp_path / "out" / "extended_model.json").model
    ratio = extended.response([10.0]) / identified.model.response([10.0])
    np.testing.assert_allclose(ratio[0, 0], 1.03, rtol=2e-3)
    assert main([*given, "--holdout", str(table)]) == 2
    assert "--holdout is for a model of one axis" in capsys.readouterr().err
    assert main(["--model", str(model), "--data", str(table), str(table), "--output",
                 str(tmp_path / "out")]) == 2
    assert "give one recording for a model of several axes" in capsys.readouterr().err
