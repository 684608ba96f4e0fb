# SPDX-License-Identifier: BSD-3-Clause
"""Modes from measured responses of two and three axes, against systems of python-control."""

import sys
from dataclasses import replace
from pathlib import Path

import control
import numpy as np
import pytest

from piezo_identification.axes.axes_response import (
    AxesResponse,
    is_axes_response,
    read_axes_response,
)
from piezo_identification.axes.identify_axes import identify_several_axes
from piezo_identification.commands.check_command import main as check_main
from piezo_identification.commands.identify_command import main as identify_main
from piezo_models.axes_model_file import load_axes_model
from piezo_recorder.reading.axes import axes_recordings_of_arrays
from piezo_recorder.reading.recording import RecordingError

sys.path.insert(0, str(Path(__file__).parent))
import flexure

FREQUENCY_HZ = np.arange(5.0, 2000.0, 5.0)
NOISE_UM_PER_V = 3e-4
"""Root of the mean square error of each complex gain."""
HELD_HZ = 10_000.0

MODES_HZ = (310.0, 365.0, 720.0, 1100.0)
DAMPING = (0.012, 0.015, 0.02, 0.01)
SHAPES = np.array([[1.0, 0.1, 0.05], [-0.12, 1.0, 0.1], [0.2, 0.3, 1.0], [0.4, -0.3, 0.3]])
PUSHES = np.array([[1.0, -0.1, 0.1], [0.08, 1.0, -0.1], [0.15, 0.3, 1.0], [0.3, 0.4, -0.2]])
STATIC_UM_PER_V = 0.2


def stage(n):
    """Return a continuous system of n axes, with one mode more than axes."""
    parts = []
    for mode_hz, damping, shape, push in zip(MODES_HZ, DAMPING, SHAPES, PUSHES, strict=True):
        rate = 2.0 * np.pi * mode_hz
        parts.append(control.ss(
            [[0.0, 1.0], [-rate**2, -2.0 * damping * rate]],
            np.vstack([np.zeros(n), rate**2 * push[:n]]),
            np.column_stack([STATIC_UM_PER_V * shape[:n], np.zeros(n)]), np.zeros((n, n))))
    return sum(parts[1: n + 1], parts[0])


def measured(n, seed, is_held=False):
    """Return the noisy response, between held samples or continuous signals."""
    system = control.sample_system(stage(n), 1.0 / HELD_HZ) if is_held else stage(n)
    response = control.frequency_response(system, 2.0 * np.pi * FREQUENCY_HZ)
    rng, shape = np.random.default_rng(seed), response.frdata.shape
    noise = (rng.normal(size=shape) + 1j * rng.normal(size=shape)) / np.sqrt(2.0)
    return control.frd(response.frdata + NOISE_UM_PER_V * noise, response.omega, dt=system.dt)


def within_interval(coupling, frequency_hz, true_gain):
    """Return for each entry the part of real and imaginary parts within the 90 % intervals.

    Parameters
    ----------
    frequency_hz : array
        Measured frequencies; those beyond are left out.
    true_gain : callable
        Returns the true response at some frequencies.
    """
    seen = (frequency_hz[0] <= coupling.frequency_hz) & (coupling.frequency_hz <= frequency_hz[-1])
    true = true_gain(coupling.frequency_hz[seen])
    low, high = (each[seen] for each in coupling.interval_90())
    return np.mean([(low.real <= true.real) & (true.real <= high.real),
                    (low.imag <= true.imag) & (true.imag <= high.imag)], axis=(0, 1))


def response_of(n, seed, is_held=False, is_known=True):
    known = np.full((FREQUENCY_HZ.size, n, n), NOISE_UM_PER_V)
    return AxesResponse.from_control(
        measured(n, seed, is_held), deviation_um_per_v=known if is_known else None)


def sampled_gain(n, frequency_hz, sample_rate_hz):
    sampled = control.sample_system(stage(n), 1.0 / sample_rate_hz)
    return np.moveaxis(sampled(np.exp(2j * np.pi * frequency_hz / sample_rate_hz)), 2, 0)


def errors_of_poles(identified, modes):
    """Return errors of decay and frequency of each mode over their standard deviations."""
    poles = identified.model.poles_rad_per_s
    assert poles.size == modes
    order = np.argsort(poles.imag)
    rate, damping = (np.array(each[:modes]) for each in (MODES_HZ, DAMPING))
    error = poles[order] - 2.0 * np.pi * rate * (-damping + 1j * np.sqrt(1.0 - damping**2))
    known = identified.pole_deviations_rad_per_s[order]
    return [np.abs(error.real) / known.real, np.abs(error.imag) / known.imag]


MORE_DRAWS = [2, pytest.param(6, marks=pytest.mark.long)]
"""Each draw has hundreds of entries: two show an interval that is too wide or too narrow."""


@pytest.mark.parametrize("draws", MORE_DRAWS)
@pytest.mark.parametrize(("n", "is_held", "is_known"), [
    pytest.param(2, False, True, marks=pytest.mark.long), (2, True, False),
    pytest.param(3, False, False, marks=pytest.mark.long), (3, True, True)])
def test_intervals_hold_in_nine_of_ten_draws(n, is_held, is_known, draws):
    within, off = [], []
    for seed in range(draws):
        response = response_of(n, seed, is_held, is_known)
        identified = identify_several_axes(response)
        within.append(within_interval(
            identified.coupling, FREQUENCY_HZ,
            lambda at_hz, rate_hz=response.sample_rate_hz: sampled_gain(n, at_hz, rate_hz)))
        off.append(errors_of_poles(identified, n + 1))
    assert 0.8 < np.mean(within) < 0.98
    assert np.all(np.mean(within, axis=0) > 0.7), "each entry"
    assert np.mean(np.array(off) < 1.6449) > 0.8
    assert np.max(off) < 4.0


@pytest.mark.parametrize("draws", [4, pytest.param(6, marks=pytest.mark.long)])
def test_the_covariance_of_correlated_errors_gives_the_deviations_of_the_modes(draws):
    correlation, off, without = 0.95, [], []
    entries = (1.0 - correlation) * np.eye(4) + correlation
    covariance = np.tile(NOISE_UM_PER_V**2 * entries.reshape(2, 2, 2, 2),
                         (FREQUENCY_HZ.size, 1, 1, 1, 1)).astype(complex)
    true = control.frequency_response(stage(2), 2.0 * np.pi * FREQUENCY_HZ)
    for seed in range(draws):
        rng = np.random.default_rng(seed)
        noise = rng.normal(size=(2, FREQUENCY_HZ.size, 4)) @ np.linalg.cholesky(entries).T
        error = NOISE_UM_PER_V / np.sqrt(2.0) * (noise[0] + 1j * noise[1])
        response = replace(AxesResponse.from_control(true), covariance_um2_per_v2=covariance)
        response = replace(response, gain_um_per_v=response.gain_um_per_v
                           + error.reshape(-1, 2, 2))
        identified = identify_several_axes(response, pairs=3)
        alone = identify_several_axes(replace(
            response, covariance_um2_per_v2=None,
            deviation_um_per_v=np.full((FREQUENCY_HZ.size, 2, 2), NOISE_UM_PER_V)), pairs=3)
        off.append(errors_of_poles(identified, 3))
        without.append(errors_of_poles(alone, 3))
    of_modes, then = (np.sqrt(np.mean(np.square(each), axis=(0, 1))) for each in (off, without))
    assert np.all((0.6 < of_modes) & (of_modes < 1.5))
    assert then.min() < 0.5, "twice too wide if the errors are taken for independent"


def test_a_delay_of_the_sensors_is_found():
    late_s = 1.3e-4
    turn = np.exp(-2j * np.pi * FREQUENCY_HZ * late_s)
    response = response_of(2, 1)
    response = replace(response, gain_um_per_v=response.gain_um_per_v * turn[:, None, None])
    identified = identify_several_axes(response)
    np.testing.assert_allclose(identified.delays_s, late_s, atol=1e-6)


@pytest.mark.parametrize("draws", MORE_DRAWS)
def test_intervals_hold_with_sensors_that_are_late_by_parts_of_a_sample(draws):
    frequency_hz, within = np.arange(5.0, 2500.0, 5.0), []
    true = flexure.response(frequency_hz)
    for seed in range(draws):
        noise = np.random.default_rng(seed).normal(size=(2, *true.shape)) / np.sqrt(2.0)
        identified = identify_several_axes(AxesResponse(
            ("x", "y"), frequency_hz, true + NOISE_UM_PER_V * (noise[0] + 1j * noise[1]),
            np.full(true.shape, NOISE_UM_PER_V), sample_rate_hz=1.0 / flexure.PERIOD_S,
            is_held=True))
        within.append(within_interval(identified.coupling, frequency_hz, flexure.response))
        off_s = identified.delays_s - np.array(flexure.LATE) * flexure.PERIOD_S
        assert np.all(np.abs(off_s) < 4.0 * identified.delay_deviations_s)
    assert 0.8 < np.mean(within) < 0.98
    assert np.all(np.mean(within, axis=0) > 0.7), "each entry"


def test_unseen_motion_is_predicted_and_python_control_takes_the_model():
    rng = np.random.default_rng(3)
    sampled = control.sample_system(stage(2), 1.0 / HELD_HZ)
    voltage_v = rng.normal(size=(3000, 2)) * (np.arange(3000)[:, None] > 20)
    moved_um = control.forced_response(sampled, inputs=voltage_v.T).outputs.T
    unseen, = axes_recordings_of_arrays(voltage_v, moved_um, HELD_HZ, ("x", "y"))
    identified = identify_several_axes(response_of(2, 1, is_held=True), [unseen])
    assert all(error["e_y_percent"] < 0.1 for error in identified.errors.values())
    again = control.forced_response(
        identified.model.to_control(), inputs=voltage_v.T).outputs.T
    assert np.std(again - moved_um) < 1e-3 * np.std(moved_um)


def test_axes_that_are_not_coupled_at_all_are_identified():
    modes = [control.tf(gain, [1.0 / rate**2, 0.1 / rate, 1.0])
             for gain, rate in ((1.0, 1000.0), (2.0, 1400.0))]
    ideal = control.frequency_response(control.append(*modes), np.geomspace(100.0, 1e4, 60))
    found = identify_several_axes(AxesResponse.from_control(ideal), pairs=2).model
    assert np.sort(np.abs(found.poles_rad_per_s)) == pytest.approx([1000.0, 1400.0], rel=1e-6)


def test_creep_beside_a_response_is_refused():
    recording, = axes_recordings_of_arrays(np.eye(50)[:, :2], np.eye(50)[:, :2], 1e4, ("x", "y"))
    with pytest.raises(RecordingError, match="creep and hysteresis are not estimated"):
        identify_several_axes(response_of(2, 1), creep=[recording])


@pytest.mark.parametrize(("changes", "message"), [
    ({"axes": ("x",)}, "has 1 axes: give 2 to 3"),
    ({"axes": ("x", "y", "z")}, r"has the shape \(399, 2, 2\) at \(399,\) frequencies"),
    ({"frequency_hz": FREQUENCY_HZ[1:]}, r"has the shape \(399, 2, 2\) at \(398,\) frequencies"),
    ({"frequency_hz": FREQUENCY_HZ[::-1]}, "not positive and rising"),
    ({"frequency_hz": FREQUENCY_HZ - 5.0}, "not positive and rising"),
    ({"gain_um_per_v": np.where(np.arange(399)[:, None, None] == 7, np.nan, np.ones((2, 2)))},
     "x from x has no gain that is finite at 40 Hz"),
    ({"deviation_um_per_v": np.ones((399, 2, 2)) - np.eye(2)[::-1]},
     "x from y has no positive deviation at 5 Hz")])
def test_invalid_responses_are_refused(changes, message):
    with pytest.raises(ValueError, match=message) as refused:
        replace(response_of(2, 1), **changes)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(("is_held", "least"), [(False, "above 19950 Hz"), (True, "above 3990 Hz")])
def test_a_rate_that_does_not_show_the_frequencies_is_refused(is_held, least):
    response = replace(response_of(2, 1), sample_rate_hz=3000.0, is_held=is_held)
    with pytest.raises(ValueError, match=least):
        identify_several_axes(response)


def test_a_response_that_is_not_square_is_refused():
    response = control.frd(np.ones((2, 3, 5)), np.arange(1.0, 6.0))
    with pytest.raises(ValueError, match="3 inputs and 2 outputs"):
        AxesResponse.from_control(response)


def columns_of(response, is_polar=False):
    """Return the columns of a table."""
    columns = {"frequency_hz": response.frequency_hz}
    for i, moved in enumerate(response.axes):
        for j, driven in enumerate(response.axes):
            gain, entry = response.gain_um_per_v[:, i, j], f"{moved}_from_{driven}"
            polar = {f"{entry}_gain": np.abs(gain), f"{entry}_phase_deg": np.angle(gain, deg=True)}
            cartesian = {f"{entry}_gain_re": gain.real, f"{entry}_gain_im": gain.imag}
            columns |= polar if is_polar else cartesian
            if response.deviation_um_per_v is not None:
                columns[f"{entry}_deviation"] = response.deviation_um_per_v[:, i, j]
    return columns


def write(path, columns):
    np.savetxt(path, np.column_stack(list(columns.values())), "%.17g", ",",
               header=",".join(columns), comments="")
    return path


@pytest.mark.parametrize("is_known", [True, False])
@pytest.mark.parametrize("is_polar", [True, False])
def test_a_table_is_read_as_it_was(tmp_path, is_polar, is_known):
    response = response_of(3, 1, is_known=is_known)
    path = write(tmp_path / "response.csv", columns_of(response, is_polar))
    assert is_axes_response(path)
    read = read_axes_response(path)
    assert read.axes == ("x", "y", "z")
    np.testing.assert_allclose(read.frequency_hz, FREQUENCY_HZ)
    np.testing.assert_allclose(read.gain_um_per_v, response.gain_um_per_v, rtol=1e-9)
    if is_known:
        np.testing.assert_allclose(read.deviation_um_per_v, response.deviation_um_per_v)
    else:
        assert read.deviation_um_per_v is None


def test_arrays_in_a_file_are_read(tmp_path):
    response = response_of(2, 1)
    np.savez(tmp_path / "response.npz", **columns_of(response))
    assert is_axes_response(tmp_path / "response.npz")
    np.testing.assert_array_equal(
        read_axes_response(tmp_path / "response.npz").gain_um_per_v, response.gain_um_per_v)


@pytest.mark.parametrize("missing", ["y_from_x_gain_im", "x_from_y_deviation"])
def test_a_table_without_an_entry_is_refused(tmp_path, missing):
    columns = columns_of(response_of(2, 1))
    del columns[missing]
    path = write(tmp_path / "response.csv", columns)
    with pytest.raises(ValueError, match=f"has no column {missing}"):
        read_axes_response(path)


@pytest.mark.parametrize(("change", "message"), [
    (lambda lines: [*lines[:2], lines[3], lines[2]], "not positive and rising"),
    (lambda lines: [*lines[:2], lines[2].replace(",", ",nan,", 1), *lines[3:]], "row 3"),
    (lambda lines: [*lines[:2], lines[2].rpartition(",")[0] + ",", *lines[3:]], "at 10 Hz")])
def test_invalid_rows_are_refused(tmp_path, change, message):
    path = write(tmp_path / "response.csv", columns_of(response_of(2, 1)))
    path.write_text("\n".join(change(path.read_text().splitlines())) + "\n")
    with pytest.raises(ValueError, match=message) as refused:
        read_axes_response(path)
    assert "\n" not in str(refused.value)


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    return write(tmp_path_factory.mktemp("response") / "response.csv",
                 columns_of(response_of(2, 1, is_held=True)))


def test_identify_takes_a_table(table, capsys):
    model = table.with_name("model.json")
    assert identify_main(["--dynamics", str(table), "--response", "zero-order-hold",
                          "--response-rate-hz", "10000", "--output", str(model)]) == 0
    identified = load_axes_model(model)
    assert identified.model.sample_period_s == pytest.approx(1.0 / HELD_HZ)
    assert identified.recordings[0]["path"] == str(table)
    np.testing.assert_allclose(identified.voltage_range_v, [[-1000.0, 1000.0]] * 2)
    assert "x from y" in capsys.readouterr().out


def test_check_names_the_entries_and_the_next_command(table, tmp_path, capsys):
    assert check_main(["--data", str(table), "--output", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "x from y" in printed
    assert "a frequency response of 399 points, 5 to 1995 Hz" in printed
    assert f"--dynamics {table}" in printed


@pytest.mark.parametrize(("arguments", "message"), [
    (["--dynamics", "TABLE", "TABLE"], "give no other file to --dynamics"),
    (["--dynamics", "TABLE", "--response-rate-hz", "0"], "give a positive rate"),
    (["--dynamics", "TABLE", "--response-rate-hz", "5000"], "give a rate above 19950 Hz"),
    (["--dynamics", "TABLE", "--band", "1", "2"], "--band is for one axis"),
    (["--creep", "TABLE"], "has 0 axes")])
def test_identify_refuses_in_one_line(table, tmp_path, capsys, arguments, message):
    assert identify_main([*(str(table) if each == "TABLE" else each for each in arguments),
                          "--output", str(tmp_path / "model.json")]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
