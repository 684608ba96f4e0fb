# SPDX-License-Identifier: BSD-3-Clause
"""The waveforms for other instruments: what the files hold, and what a recording of them is."""

import numpy as np
import pytest

from piezo_identification.commands.waveforms_command import NAMES, main
from piezo_identification.recording_check.check import check_recording
from piezo_identification.recording_check.suitability import suitability
from piezo_recorder.reading.reader import read_recording

RANGE_V = (-10.0, 90.0)
PURPOSES = {"multisine": "dynamics", "distortion": "dynamics"}
"""Experiments whose recordings stand for one of another name."""


def written(directory, *options):
    return main(["--directory", str(directory), "--range", *map(str, RANGE_V), *options])


def read(path):
    time_s, voltage_v = np.loadtxt(path, delimiter=",", skiprows=1, unpack=True)
    return time_s, voltage_v


@pytest.mark.parametrize("name", sorted(set(NAMES) - {"creep", "diagnostic", "distortion"}))
def test_file_begins_and_ends_at_rest_within_range_rate_and_slew(tmp_path, name):
    assert written(tmp_path, "--rate", "10000", "--rest", "5", "--levels", "6",
                   "--experiments", name) == 0
    time_s, voltage_v = read(tmp_path / f"{name}.csv")
    assert voltage_v[0] == voltage_v[-1] == 5.0
    assert RANGE_V[0] - 1e-6 <= voltage_v.min() and voltage_v.max() <= RANGE_V[1] + 1e-6
    period_s = time_s[1] - time_s[0]
    assert np.allclose(np.diff(time_s), period_s, rtol=0, atol=1e-7)
    assert 10000.0 * period_s == pytest.approx(round(10000.0 * period_s))
    ramp_v = 2000.0 * period_s
    assert abs(voltage_v[1] - voltage_v[0]) <= ramp_v + 1e-6
    assert abs(voltage_v[-2] - voltage_v[-1]) <= ramp_v + 1e-6


def test_sweep_reaches_both_ends_of_the_range(tmp_path):
    written(tmp_path, "--rate", "10000", "--experiments", "sweep")
    _, voltage_v = read(tmp_path / "sweep.csv")
    assert (voltage_v.min(), voltage_v.max()) == RANGE_V


@pytest.mark.parametrize(("name", "verdict"), [
    ("creep", "yes"), ("dynamics", "yes"), ("hysteresis", "yes"), ("multisine", "yes"),
    ("distortion", "yes"), ("validation", "yes")])
def test_recording_of_a_file_is_what_it_was_written_for(tmp_path, name, verdict, plant):
    written(tmp_path, "--rate", "10000", "--levels", "20", "--experiments", name)
    time_s, voltage_v = read(tmp_path / f"{name}.csv")
    displacement_um = plant.simulate(voltage_v, time_s[1] - time_s[0])
    displacement_um += 0.002 * np.random.default_rng(1).standard_normal(voltage_v.size)
    path = tmp_path / "recorded.csv"
    np.savetxt(path, np.c_[time_s, voltage_v, displacement_um], "%.9g", ",", comments="",
               header="time_s,voltage_v,displacement_um")
    check = check_recording(read_recording(str(path)))
    assert check.start.startswith("at rest: the first ")
    assert suitability(check)[PURPOSES.get(name, name)].verdict == verdict


@pytest.mark.parametrize(("options", "sentence"), [
    (["--rate", "100"], "tones up to 1000 Hz need a sample clock of more than 2000 Hz"),
    (["--rate", "-1"], "--rate -1 is not above 0"),
    (["--rate", "1e4", "--rest", "200"], "--rest 200 is outside the range"),
    (["--rate", "1e4", "--levels", "1"], "--levels 1 is not within 2 to 300"),
    (["--rate", "1e4", "--slew-limit", "1000"], "needs a slew of"),
])
def test_what_does_not_fit_is_refused_in_one_line_and_leaves_no_file(
        tmp_path, capsys, options, sentence):
    assert written(tmp_path / "files", *options) == 2
    printed = capsys.readouterr().err
    assert sentence in printed and printed.count("\n") == 1
    assert not (tmp_path / "files").exists()


def test_empty_range_is_refused(tmp_path, capsys):
    assert main(["--directory", str(tmp_path), "--range", "5", "5", "--rate", "1e4"]) == 2
    assert "--range 5 5 is empty: give the lower end first" in capsys.readouterr().err


def test_waveform_that_is_there_is_kept_unless_it_may_be_replaced(tmp_path, capsys):
    options = "--rate", "10000", "--levels", "2", "--experiments", "hysteresis"
    kept = tmp_path / "hysteresis.csv"
    kept.write_text("the waveform of a recording")
    assert written(tmp_path, *options, "sweep") == 2
    assert f"{kept} exists already and is not overwritten" in capsys.readouterr().err
    assert [*tmp_path.iterdir()] == [kept]
    assert kept.read_text() == "the waveform of a recording"
    assert written(tmp_path, *options, "--force") == 0
    assert kept.read_text().startswith("time_s,voltage_v")
