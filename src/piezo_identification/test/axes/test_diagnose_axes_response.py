# SPDX-License-Identifier: BSD-3-Clause
"""What a frequency response of several axes shows that a model lacks, against other equations."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import control
import numpy as np
import pytest

from piezo_identification import AxesResponse
from piezo_identification.axes.diagnose_axes import diagnose_axes
from piezo_identification.axes.identify_axes import identify_several_axes
from piezo_identification.commands.diagnose_command import main
from piezo_models.axes.actuator import Actuator
from piezo_models.axes.coupled import Softening
from piezo_models.axes_model_file import save_axes_model
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics

sys.path.insert(0, str(Path(__file__).parent))
from test_axes_response import HELD_HZ, NOISE_UM_PER_V, stage
from test_diagnose_axes import label

FREQUENCY_HZ = np.arange(5.0, 2000.0, 10.0)

CROSSTALK = 0.02
STATIC = 0.2


def mode_gain(frequency_hz, mode_hz, damping, column, gains):
    """Return what one axis drives alone, (K, n, n), sampled by python-control."""
    rate = 2.0 * np.pi * mode_hz
    held = control.sample_system(
        control.tf(rate**2, [1.0, 2.0 * damping * rate, rate**2]), 1.0 / HELD_HZ)
    gain = np.zeros((frequency_hz.size, len(gains), len(gains)), dtype=complex)
    gain[:, :, column] = np.outer(held(np.exp(2j * np.pi * frequency_hz / HELD_HZ)), gains)
    return gain


def response(n, seed, is_known=True, is_held=True, late_s=(), driven=None, seen=None, added=0.0,
             noise=NOISE_UM_PER_V):
    """Return the noisy response of a stage with mixed voltages and readings."""
    system = control.sample_system(stage(n), 1.0 / HELD_HZ) if is_held else stage(n)
    true = np.moveaxis(control.frequency_response(
        system, 2.0 * np.pi * FREQUENCY_HZ).frdata, 2, 0)
    true = (np.eye(n) if seen is None else seen) @ true @ (np.eye(n) if driven is None else driven)
    turn = np.exp(-2j * np.pi * np.outer(FREQUENCY_HZ, [*late_s, *[0.0] * (n - len(late_s))]))
    drawn = np.random.default_rng(seed).normal(size=(2, *true.shape)) / np.sqrt(2.0)
    return AxesResponse(
        ("x", "y", "z")[:n], FREQUENCY_HZ, turn[:, :, None] * true + added + noise * (
            drawn[0] + 1j * drawn[1]), np.full(true.shape, noise) if is_known else None,
        sample_rate_hz=HELD_HZ, is_held=is_held)


def below(measured, highest_hz):
    kept = measured.frequency_hz < highest_hz
    return replace(measured, frequency_hz=measured.frequency_hz[kept], gain_um_per_v=(
        measured.gain_um_per_v[kept]), deviation_um_per_v=None)


# Their number is asked for where they are identified.
@pytest.fixture(scope="module")
def two():
    return identify_several_axes(response(2, 0), pairs=3)


@pytest.fixture(scope="module")
def three():
    return identify_several_axes(response(3, 0), pairs=4)


def mixed(n, row, column, part):
    matrix = np.eye(n)
    matrix[row, column] += part
    return matrix


CASES = {
    "gain[x]": ({"seen": mixed(2, 0, 0, 0.01)}, 0.01),
    "squareness[y,x]": ({"seen": mixed(2, 1, 0, 0.01)}, 0.01),
    "cross_coupling[x,y]": ({"driven": mixed(2, 0, 1, CROSSTALK)}, CROSSTALK * STATIC),
    "delay[y]": ({"late_s": (0.0, 3e-5)}, 3e-5)}
SHOWN_ELSEWHERE = ("squareness[y,x]", "delay[y]", "gain[x]")
"""Of three axes, by the command, and of recordings."""


def named(diagnosis):
    assert diagnosis.verdict == "explained", repr(diagnosis)
    effect, = diagnosis.effects
    return label(effect), effect["parameters"], effect["standard_deviations"]


@pytest.mark.parametrize("is_known", [
    True, pytest.param(False, marks=pytest.mark.long)])
@pytest.mark.parametrize("name", [
    pytest.param(name, marks=[pytest.mark.long] * (name in SHOWN_ELSEWHERE)) for name in CASES])
def test_effect_is_named_with_its_axis(two, name, is_known):
    changes, value = CASES[name]
    found, parameters, deviations = named(diagnose_axes(two, response(2, 5, is_known, **changes)))
    assert found == name
    (parameter, off), = deviations.items()
    if not name.startswith("cross"):  # whose static gain is not exactly this
        assert abs(parameters[parameter] - value) < 4.0 * off
    assert abs(parameters[parameter] - value) < 0.1 * abs(value)


@pytest.mark.long
def test_effect_of_three_axes_is_named_with_its_pair_and_the_extended_model_has_it(three):
    changed = response(3, 5, seen=mixed(3, 2, 0, -0.01))
    diagnosis = diagnose_axes(three, changed)
    found, parameters, _ = named(diagnosis)
    assert found == "squareness[z,x]"
    assert parameters["angle_rad"] == pytest.approx(-0.01, rel=0.05)
    again = diagnose_axes(diagnosis.extended, response(3, 6, seen=mixed(3, 2, 0, -0.01)))
    assert (again.verdict, again.effects) == ("none", [])
    assert all(again.before[axis]["rms_um"] < 1.1 * again.noise_floor_um[axis] for axis in "xyz")


@pytest.mark.parametrize("axis", ["x", pytest.param("y", marks=pytest.mark.long)])
def test_mode_that_one_axis_drives_is_named_with_it(two, axis):
    values = (520.0, 0.01, 0.004, -0.002)
    added = mode_gain(FREQUENCY_HZ, *values[:2], "xy".index(axis), values[2:])
    found, parameters, deviations = named(diagnose_axes(two, response(2, 3, added=added)))
    assert found == f"vibration_mode[{axis}]"
    wanted = (2.0 * np.pi * values[0], *values[1:])
    for value, (name, off) in zip(wanted, deviations.items(), strict=True):
        assert abs(parameters[name] - value) < 4.0 * off < abs(value)


@pytest.mark.parametrize("seed", [
    1, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(2, 8))])
@pytest.mark.parametrize("kind", [
    pytest.param({}, id="held"), pytest.param({"is_known": False}, id="unknown noise"),
    pytest.param({"is_held": False}, id="continuous", marks=pytest.mark.long)])
def test_nothing_is_named_on_an_unchanged_stage(two, seed, kind):
    measured = response(2, seed, **kind)
    if not measured.is_held:  # samples at this rate show no more of a continuous response
        measured = below(measured, HELD_HZ / 10.0)
    diagnosis = diagnose_axes(two, measured)
    assert (diagnosis.verdict, diagnosis.effects) == ("none", [])
    assert diagnosis.not_shown == {}


def test_another_cause_is_unexplained(two):
    softer = np.array([[0.02, 0.0], [0.0, -0.02]])[None] * (FREQUENCY_HZ[:, None, None] / 1e3) ** 2
    diagnosis = diagnose_axes(two, response(2, 4, added=softer))
    assert (diagnosis.verdict, diagnosis.effects) == ("unexplained", [])
    assert "um/V remain" in diagnosis.left


def test_behind_hysteresis_and_creep_the_gain_is_not_decidable_and_other_effects_are_named(two):
    density = np.tril(np.full((12, 12), 1e-5))
    actuators = tuple(Actuator(PreisachModel(0.0, 100.0, density, 0.0, np.full(12, 1e-3)),
                               CreepDynamics((2.0 + axis,), (2.03 + axis,))) for axis in range(2))
    behind = replace(two, model=replace(two.model, actuators=actuators))
    crept = np.column_stack([each.creep_response(FREQUENCY_HZ, 1.0 / HELD_HZ)
                             for each in actuators])[:, None, :] - 1.0
    # A small loop is flatter than the large one, and lags by a constant angle.
    small = np.diag([0.8 * np.exp(-0.02j), 0.9 * np.exp(-0.03j)])
    measured = response(2, 5, driven=small @ mixed(2, 0, 1, CROSSTALK))
    measured = replace(measured, gain_um_per_v=measured.gain_um_per_v * (1.0 + crept))
    diagnosis = diagnose_axes(behind, measured)
    assert named(diagnosis)[0] == "cross_coupling[x,y]"
    assert set(diagnosis.document()["not_decidable"]) >= {"gain[x]", "gain[y]"}
    assert "amplitude, which a response does not contain" in repr(diagnosis)


@pytest.mark.parametrize(("changes", "message"), [
    ({"axes": ("x", "z")}, "has the axes x, z, and the model x, y"),
    ({"sample_rate_hz": 2e4}, "of samples at 20000 Hz, and the model of 10000 Hz")])
def test_responses_that_cannot_be_compared_are_refused(two, changes, message):
    with pytest.raises(ValueError, match=message):
        diagnose_axes(two, replace(response(2, 1), **changes))


def test_what_a_response_cannot_show_is_refused(two):
    with pytest.raises(ValueError, match="has 10 frequencies, too few to hold some out"):
        diagnose_axes(two, below(response(2, 1), 100.0))
    model = two.model
    softening = Softening(np.zeros((1, *model.residues_um_per_v.shape), dtype=complex),
                          np.zeros((1, 2, 2)), 1.0, 0.1, (0.5, 2.0))
    soft = replace(two, model=replace(model, softening=softening))
    with pytest.raises(ValueError, match="depend on the amplitude of the voltage, which .* not"):
        diagnose_axes(soft, response(2, 1))


def test_command_writes_verdict_of_a_response(two, tmp_path, capsys):
    model, table = tmp_path / "model.json", tmp_path / "later.csv"
    save_axes_model(model, two)
    measured = response(2, 5, **CASES["delay[y]"][0])
    entries = [(i, j) for i in range(2) for j in range(2)]
    gains = [measured.gain_um_per_v[:, i, j] for i, j in entries]
    columns = [part for gain in gains for part in (gain.real, gain.imag)]
    labels = [f"{'xy'[i]}_from_{'xy'[j]}_gain_{part}" for i, j in entries for part in ("re", "im")]
    np.savetxt(table, np.column_stack([measured.frequency_hz, *columns]), delimiter=",",
               comments="", header=",".join(["frequency_hz", *labels]))
    given = ["--model", str(model), "--data", str(table), "--output", str(tmp_path / "out")]
    held = ["--response", "zero-order-hold", "--response-rate-hz", "10000"]
    assert main([*given, *held]) == 0
    assert "verdict: explained" in capsys.readouterr().out
    verdict = json.loads((tmp_path / "out" / "verdict.json").read_text())
    assert [label(each) for each in verdict["effects"]] == ["delay[y]"]
    assert set(verdict) == {
        "verdict", "effects", "before", "after", "noise_floor_um", "not_decidable",
        "not_decidable_because", "not_told_from", "left", "probabilities"}
    assert main([*given, "--response-rate-hz", "10000"]) == 2
    assert "--response-rate-hz has nothing to act on" in capsys.readouterr().err
