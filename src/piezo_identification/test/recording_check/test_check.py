# SPDX-License-Identifier: BSD-3-Clause
"""A recording's noise, drift, start and use are those with which it was made."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import chirp, cont2discrete, lfilter

from piezo_identification.commands.check_command import main
from piezo_identification.experiments import catalogue as experiments
from piezo_identification.recording_check.check import check_recording
from piezo_identification.recording_check.check_report import measured_rows
from piezo_identification.recording_check.suitability import (
    Suitability,
    given_as,
    suitability,
    suitability_for,
)
from piezo_identification.report.check_page import check_figure
from piezo_recorder.reading.reader import read_recording


@pytest.fixture
def read(tmp_path, save_csv):
    def save(voltage_v, displacement_um, period_s, name="data.csv"):
        return read_recording(save_csv(
            tmp_path / name, period_s * np.arange(len(voltage_v)), voltage_v, displacement_um))
    return save


def vibrating(voltage_v, period_s, frequency_hz=300.0, damping=0.05):
    """Displacement of one mode, by SciPy."""
    w = 2.0 * np.pi * frequency_hz
    (numerator,), denominator, _ = cont2discrete(
        ([0.2 * w * w], [1.0, 2.0 * damping * w, w * w]), period_s)
    return lfilter(numerator, denominator, voltage_v)


def test_a_tracking_run_shows_reference_displacement_and_error(read):
    """A run that lags by 40 nm while it rises and falls, and whose first rows follow nothing."""
    time_s = 1e-3 * np.arange(4000)
    reference_um = 20.0 + 5.0 * np.sin(2.0 * np.pi * 5.0 * time_s)
    displacement_um = reference_um + 0.04 * np.sign(np.sin(2.0 * np.pi * 5.0 * time_s + 0.01))
    plain = read(3.0 * reference_um, displacement_um, 1e-3)
    reference_um[:150] = np.nan
    check = check_recording(replace(plain, reference_um=reference_um))
    rows = dict(measured_rows(check))
    assert rows["reference"] == "15 to 25 um"
    assert rows["error"].startswith("0.04 um RMS, largest 0.04 um")
    figure = check_figure(check)
    axes = {one.get_ylabel(): one for one in figure.axes}
    left_nm = axes["error (nm)"].lines[0].get_ydata()
    np.testing.assert_allclose(np.abs(left_nm), 40.0, atol=0.01)
    assert {line.get_label() for line in figure.axes[0].lines} == {"displacement", "reference"}
    without = check_recording(plain)
    assert "error" not in dict(measured_rows(without))
    assert "error (nm)" not in {one.get_ylabel() for one in check_figure(without).axes}


@pytest.mark.parametrize("name, maker, clock_hz", [
    ("creep", experiments.creep, 100.0),
    ("dynamics", experiments.dynamics, 40_000.0),
    ("dynamics", lambda: experiments.multisine(tones_s=0.4), 40_000.0),
    ("hysteresis", lambda: experiments.hysteresis(level_count=35), 1000.0),
])
def test_designed_experiment_can_stand_for_itself(play, name, maker, clock_hz):
    check = check_recording(play(maker(), 1, clock_hz))
    fit = suitability(check)
    assert fit[name].verdict in ("yes", "partly"), fit[name].reason
    assert fit["validation"].verdict == "yes"
    for other in {"creep", "dynamics", "hysteresis"} - {name}:
        assert fit[other].verdict == "no", (other, fit[other].reason)


@pytest.mark.parametrize("kind", ["chirp", "noise"])
def test_a_mode_that_rings_for_long_over_fast_rows_is_dynamics(read, kind):
    period_s, random = 1e-4, np.random.default_rng(4)
    time_s = period_s * np.arange(20_000)
    voltage_v = 50.0 + (5.0 * np.sin(2.0 * np.pi * (1.0 + 100.0 * time_s) * time_s)
                        if kind == "chirp" else np.repeat(random.normal(size=5000), 4))
    noise_um = 0.005 * random.normal(size=time_s.size)
    ringing_um = vibrating(voltage_v, period_s, 80.0, 0.02) + noise_um
    check = check_recording(read(voltage_v, ringing_um, period_s))
    assert check.waveform.kind == kind
    assert suitability_for(check, "dynamics").verdict == "yes"
    at_once = check_recording(read(voltage_v, 0.2 * voltage_v + noise_um, period_s))
    assert suitability_for(at_once, "dynamics").verdict == "no"


def test_a_chirp_that_begins_slowly_is_dynamics_where_its_mode_rings(read):
    period_s = 5e-5
    time_s = period_s * np.arange(80_000)
    voltage_v = 50.0 + 5.0 * chirp(time_s, 1.0, time_s[-1], 4000.0, method="logarithmic")
    noise_um = 0.02 * np.random.default_rng(4).normal(size=time_s.size)
    ringing_um = vibrating(voltage_v - voltage_v[0], period_s, 700.0, 0.01) + noise_um
    check = check_recording(read(voltage_v, ringing_um, period_s))
    assert suitability_for(check, "dynamics").verdict == "yes"


def test_a_mode_is_dynamics_in_a_recording_that_has_everything(read):
    """Steps and loops over the whole range have but a millionth of their power at the mode."""
    period_s, random = 1e-4, np.random.default_rng(4)
    steps_v = np.repeat(random.uniform(0.0, 150.0, 40), random.integers(500, 2500, 40))
    time_s = period_s * np.arange(20_000)
    swept_v = steps_v[-1] + 4.0 * np.sin(2.0 * np.pi * 250.0 * time_s**2)
    loops_v = np.interp(np.arange(16_000), 4000 * np.arange(5), [swept_v[-1], 0, 150, 0, 75])
    voltage_v = np.concatenate([steps_v, swept_v, loops_v])
    noise_um = 0.005 * random.normal(size=voltage_v.size)
    ringing_um = vibrating(voltage_v - voltage_v[0], period_s, 310.0, 0.015) + noise_um
    fit = suitability_for(check_recording(read(voltage_v, ringing_um, period_s)), "dynamics")
    assert fit.verdict == "yes", fit.reason


def test_a_slow_resonance_beside_a_part_that_follows_at_once_is_dynamics(read):
    """Where most happens, at high frequency, the displacement follows the voltage at once."""
    period_s, random = 5e-4, np.random.default_rng(4)
    time_s, tones_hz = period_s * np.arange(4000), np.arange(0.5, 200.0, 0.5)
    turned = 2.0 * np.pi * (tones_hz * time_s[:, None] + random.uniform(size=tones_hz.size))
    voltage_v = 50.0 + np.tile(0.3 * np.cos(turned).sum(axis=1), 8)
    ringing_um = 0.2 * voltage_v + 0.2 * vibrating(voltage_v - 50.0, period_s, 7.0, 0.03)
    noise_um = 0.005 * random.normal(size=voltage_v.size)
    fit = suitability_for(check_recording(read(voltage_v, ringing_um + noise_um, period_s)),
                          "dynamics")
    assert fit.verdict == "yes", fit.reason
    at_hz = float(re.search(r"at ([0-9.]+) Hz", fit.reason).group(1))
    assert 6.0 < at_hz < 8.0


def test_rows_before_and_behind_the_waveform_are_named_and_show_the_rest(read):
    random = np.random.default_rng(5)
    square_v = np.tile(np.repeat([20.0, 80.0], 300), 4)
    ways_v = np.concatenate([np.full(30, 5.0), np.linspace(5.0, 20.0, 10)[:-1]])
    voltage_v = np.concatenate([ways_v, square_v, ways_v[::-1]])
    # What its first level shows creeps, as it does on every stage.
    since_s = np.maximum(np.arange(voltage_v.size) - 39, 0) * 0.01
    displacement_um = 0.2 * voltage_v - 1.0 * (np.arange(voltage_v.size) > 38) * np.exp(
        -since_s / 2.0) + 0.002 * random.normal(size=voltage_v.size)
    check = check_recording(read(voltage_v, displacement_um, 0.01))
    assert check.left_out == (39, 39)
    rows = dict(measured_rows(check))
    assert rows["left out"] == "rows 1 to 39 and 2440 to 2478, on the way from rest and back"
    assert check.starts_settled and check.start.startswith("at rest: the first 0.31 s at 5 V")
    assert suitability_for(check, "creep").verdict == "yes"


def test_recordings_are_given_for_what_they_are_fit_for():
    def fit(**verdicts):
        return {name: Suitability(verdicts.get(name, "no"), "")
                for name in ("creep", "dynamics", "hysteresis", "validation")}

    given = given_as({
        "loops.csv": fit(hysteresis="yes", creep="partly", validation="yes"),
        "steps.csv": fit(creep="yes", validation="yes"),
        "other.csv": fit(validation="yes")})
    assert given == {"creep": ["steps.csv"], "hysteresis": ["loops.csv"],
                     "validation": ["other.csv"]}
    assert given_as({"other.csv": fit(validation="yes")}) == {}
    # Loops show creep if nothing else does.
    loops, held = fit(hysteresis="yes", creep="partly"), fit(creep="partly")
    assert given_as({"loops.csv": loops, "held.csv": held}) == {
        "hysteresis": ["loops.csv"], "creep": ["held.csv"]}
    assert given_as({"loops.csv": loops}) == {
        "hysteresis": ["loops.csv"], "creep": ["loops.csv"]}
    # Without one to spare, the last of several of a kind is not fitted, so that an error is known.
    given = given_as({
        "steps.csv": fit(dynamics="yes", validation="yes"),
        "loops.csv": fit(hysteresis="yes", validation="yes"),
        "tones.csv": fit(dynamics="yes", validation="yes")})
    assert given == {"dynamics": ["steps.csv"], "hysteresis": ["loops.csv"],
                     "validation": ["tones.csv"]}


def test_steps_measured_behind_an_amplifier_are_dynamics(read):
    """The amplifier takes some rows, so that no level follows the other at once."""
    period_s, random = 5e-5, np.random.default_rng(4)
    time_s = period_s * np.arange(20_000)
    steps_v = np.where((23.7 * time_s) % 1.0 < 0.5, 30.0, 70.0)
    voltage_v = lfilter([0.1], [1.0, -0.9], steps_v, zi=[0.9 * 30.0])[0]
    ringing_um = vibrating(voltage_v, period_s) + 0.005 * random.normal(size=time_s.size)
    voltage_v += 0.01 * random.normal(size=time_s.size)
    check = check_recording(read(voltage_v, ringing_um, period_s))
    assert suitability_for(check, "dynamics").verdict == "yes"


def test_noise_and_drift_are_measured(read):
    random = np.random.default_rng(2)
    voltage_v = np.tile(50.0 - 50.0 * np.cos(2 * np.pi * np.arange(1000) / 1000), 8)
    drift_um = np.linspace(0.0, 0.7, voltage_v.size)
    displacement_um = 0.2 * voltage_v + drift_um + 0.02 * random.normal(size=voltage_v.size)
    check = check_recording(read(voltage_v, displacement_um, 1e-3))
    assert check.noise_um == pytest.approx(0.02, rel=0.15)
    assert check.drift_um == pytest.approx(0.7, rel=0.05)
    assert check.waveform.kind == "sine"
    assert check.start.startswith("in motion: its first period differs")


def test_states_at_the_start_are_told_apart(read):
    random = np.random.default_rng(3)
    noise_um = 0.005 * random.normal(size=20_000)
    time_s = 1e-2 * np.arange(20_000)
    level_v = np.where((time_s // 20.0) % 2 == 0, 10.0, 90.0)
    settled = check_recording(read(level_v, 0.2 * level_v + noise_um, 1e-2))
    assert settled.starts_settled and settled.start.startswith("at rest")
    creeping = 0.2 * level_v - 3.0 * np.exp(-time_s / 15.0) + noise_um
    check = check_recording(read(level_v, creeping, 1e-2))
    assert not check.starts_settled and check.start.startswith("still settling")
    assert suitability(check)["creep"].verdict == "partly"
    rests_v = np.append(np.full(20, 10.0), 50.0 - 40.0 * np.cos(2 * np.pi * time_s[:-20] / 40.0))
    rests_v += 1e-4 * random.normal(size=rests_v.size)
    check = check_recording(read(rests_v, 0.2 * rests_v + noise_um, 1e-2))
    assert check.starts_settled and check.start.startswith("at rest: the first 0.2")
    sine_v = 50.0 + 40.0 * np.sin(2 * np.pi * time_s / 4.0)
    check = check_recording(read(sine_v, 0.2 * sine_v + noise_um, 1e-2))
    assert check.starts_settled and check.start.startswith("periodic")
    random_v = np.cumsum(random.normal(size=20_000))
    check = check_recording(read(random_v, 0.2 * random_v + noise_um, 1e-2))
    assert not check.starts_settled and check.start.startswith("in motion")


def test_steps_that_ring_hold_dynamics_and_those_sampled_too_slowly_do_not(read):
    period_s = 1e-4
    voltage_v = np.where((np.arange(20_000) // 1000) % 2 == 0, 20.0, 80.0)
    displacement_um = vibrating(voltage_v, period_s)
    fast = suitability(check_recording(read(voltage_v, displacement_um, period_s)))
    assert fast["dynamics"].verdict == "yes"
    # A stage that settles faster, long steps, one row in a hundred.
    voltage_v = np.repeat(voltage_v[::1000], 20_000)
    displacement_um = vibrating(voltage_v, period_s, damping=0.5)
    slow = suitability(check_recording(
        read(voltage_v[99::100], displacement_um[99::100], 100 * period_s)))
    assert slow["dynamics"].verdict == "no"
    assert "too slow to hold dynamics" in slow["dynamics"].reason


def test_ten_rows_a_second_partly_hold_the_dynamics_of_a_slow_plant(read):
    voltage_v = np.where((np.arange(1200) // 120) % 2 == 0, 20.0, 80.0)
    plant = suitability_for(
        check_recording(read(voltage_v, vibrating(voltage_v, 0.1, 0.25, 0.25), 0.1)), "dynamics")
    assert plant.verdict == "partly"
    assert "too slow for a piezo stage" in plant.reason


@pytest.mark.long
def test_rows_too_slow_for_the_modes_of_a_stage_hold_no_dynamics_though_they_ring(read):
    # A mode of 400 Hz that rings for long looks as if it lagged at 50 rows a second.
    voltage_v = np.repeat([60.0, 20.0, 100.0, 0.0, 60.0], 60_000)
    displacement_um = vibrating(voltage_v, 1e-3, 400.0, 0.03)
    slow = check_recording(read(voltage_v[19::20], displacement_um[19::20], 0.02))
    assert "too slow" in suitability_for(slow, "dynamics").reason
    # At 1000 rows a second it shows, folded or with too few rows in a period.
    some = check_recording(read(voltage_v, displacement_um, 1e-3))
    fit = suitability_for(some, "dynamics")
    assert fit.verdict == "partly" and "rows in a period" in fit.reason


def test_ramps_between_levels_show_creep_and_a_slow_motion_some_of_it(read):
    time_s = 0.05 * np.arange(4000)
    ramped_v = np.interp(time_s % 100.0, [0, 10, 15, 50, 55, 100], [10, 10, 80, 80, 10, 10])
    held = check_recording(read(ramped_v, 0.2 * ramped_v, 0.05))
    assert suitability_for(held, "creep").verdict == "yes"
    for period_s in (77.0, 12.0):
        sine_v = 50.0 + 40.0 * np.sin(2.0 * np.pi * time_s / period_s)
        moving = check_recording(read(sine_v, 0.2 * sine_v, 0.05))
        assert suitability_for(moving, "creep").verdict == "partly"


def test_points_of_a_static_loop_visit_the_plane_and_fast_cycles_ask_for_dynamics(read):
    turns_v = [0, 100, 0, 90, 10, 80, 20, 70, 30, 60, 40]
    points_v = np.concatenate([np.arange(low, high, 10 * np.sign(high - low))
                               for low, high in zip(turns_v, turns_v[1:], strict=False)])
    points = check_recording(read(points_v, 0.2 * points_v, 1.0))
    assert points.visited_fraction > 0.3
    cycles_v = 50.0 - 50.0 * np.cos(2.0 * np.pi * np.arange(4000) / 200)
    fit = suitability_for(check_recording(read(cycles_v, 0.2 * cycles_v, 2e-4)), "hysteresis")
    assert fit.verdict == "partly" and "--dynamics" in fit.reason


def test_decaying_cycles_of_rising_frequency_show_loops_but_a_chirp_of_one_amplitude_does_not(read):
    period_s, cycles_v = 5e-4, []
    for frequency_hz in (1.0, 20.0, 40.0):
        cycles = frequency_hz * np.arange(0.0, 10.0 / frequency_hz, period_s)
        cycles_v.append(10.0 + (cycles - 10.0) * np.cos(2.0 * np.pi * cycles))
    decaying_v = np.concatenate(cycles_v)
    fit = suitability_for(check_recording(
        read(decaying_v, 0.2 * decaying_v, period_s)), "hysteresis")
    assert fit.verdict == "partly" and "--dynamics" in fit.reason
    time_s = period_s * np.arange(19000)
    steady_v = 10.0 + 8.0 * chirp(time_s, 1.0, 9.5, 40.0)
    fit = suitability_for(check_recording(read(steady_v, 0.2 * steady_v, period_s)), "hysteresis")
    assert fit.verdict == "no"


def test_verdict_on_one_experiment_measures_nothing_for_the_others(read, monkeypatch):
    period_s = 1e-4
    voltage_v = np.where((np.arange(20_000) // 1000) % 2 == 0, 20.0, 80.0)
    recording = read(voltage_v, vibrating(voltage_v, period_s), period_s)
    expected = suitability(check_recording(recording))["dynamics"]

    def measured(*_, **__):
        raise AssertionError("not needed for the dynamics")

    for name in ("visited_cells", "drift_of", "start_of"):
        monkeypatch.setattr(f"piezo_identification.recording_check.check.{name}", measured)
    check = check_recording(recording)
    assert suitability_for(check, "dynamics") == expected
    with pytest.raises(AssertionError):
        _ = check.visited_fraction


@pytest.mark.parametrize("voltage_v, displacement_um, said", [
    (np.full(500, 30.0), np.zeros(500), "never changes"),
    (np.sin(np.arange(10) / 2.0) * 50.0, np.arange(10.0), "10 rows are too few"),
    (50.0 * np.sin(np.arange(4000) / 99.0),
     np.minimum(10.0 * np.sin(np.arange(4000) / 99.0), 6.0)
     + np.where(np.sin(np.arange(4000) / 99.0) < 0.6,
                0.01 * np.random.default_rng(1).normal(size=4000), 0.0), "clipped"),
])
def test_recording_of_no_use_says_why(read, voltage_v, displacement_um, said):
    fit = suitability(check_recording(read(voltage_v, displacement_um, 1e-2)))
    for name, each in fit.items():
        assert each.verdict == "no", name
        assert said in each.reason


def test_command_prints_the_table_and_draws_a_picture_for_each_kind(
        tmp_path, save_csv, capsys, page_parts):
    index = np.arange(4000)
    random = np.random.default_rng(1)
    kinds = {"constant": np.full(4000, 5.0), "sine": 50.0 * np.sin(index / 99.0),
             "square": np.where(index // 400 % 2, 50.0, 0.0), "noise": 10.0 * random.normal(
                 size=4000)}
    files = [save_csv(tmp_path / f"{name}.csv", 0.01 * index, voltage_v,
                      0.2 * voltage_v + 0.01 * random.normal(size=4000))
             for name, voltage_v in kinds.items()]
    arguments = ["--data", *map(str, files), "--output", str(tmp_path / "pictures")]
    assert main(arguments) == 0
    printed = capsys.readouterr().out
    for name in kinds:
        assert re.search(rf"waveform +{name}: ", printed)
        picture = tmp_path / "pictures" / f"{name}_check.png"
        assert picture.read_bytes().startswith(b"\x89PNG")
    for row in ("sample period", "jitter", "noise", "drift", "state at the start", "Preisach plane",
                "can stand for hysteresis"):
        assert len(re.findall(f"^{row} ", printed, re.M)) == len(kinds), row
    assert re.search(r"^next: .* identify --\w+ .* --output model.json$", printed, re.M)
    page = page_parts(tmp_path / "pictures" / "check_report.html")
    assert f"report: {tmp_path / 'pictures' / 'check_report.html'}" in printed
    assert page.title == "What 4 recordings can be used for" and page.external == []
    assert all(page.is_picture(name) for name in kinds)
    measured = [dict(table[1:]) for table in page.tables if table[0] == ["measured", "value"]]
    assert [rows["waveform"].split(":")[0] for rows in measured] == list(kinds)
    _assert_each_kind_is_drawn_by_what_it_shows(page)


def test_command_whose_time_is_over_draws_nothing_and_says_so(tmp_path, save_csv, capsys):
    """The least budget: reading alone takes longer."""
    time_s = 0.01 * np.arange(4000)
    files = [save_csv(tmp_path / f"{name}.csv", time_s, np.sin(time_s), 0.2 * np.sin(time_s))
             for name in ("first", "second")]
    folder = tmp_path / "pictures"
    assert main(["--data", *map(str, files), "--output", str(folder), "--budget", "1e-9"]) == 0
    printed = capsys.readouterr().out
    assert re.search("^waveform ", printed, re.M)
    assert printed.count("the time of 1e-09 s does not suffice; not done: ") == 1
    assert f"{folder / 'first_check.png'}; {files[1]}; the page\n" in printed
    assert list(folder.iterdir()) == []


def _assert_each_kind_is_drawn_by_what_it_shows(page):
    square, noise = page.numbers("square"), page.numbers("noise")
    assert max(square["time in the period (s)"]) == pytest.approx(7.99)
    assert np.ptp(square["displacement: displacement (um)"]) == pytest.approx(10.0, rel=0.01)
    assert max(np.abs(square["upper level: change (nm)"])) < 100.0
    assert np.median(noise["measured: gain (um/V)"]) == pytest.approx(0.2, rel=0.02)
    assert min(noise["coherence (1)"]) > 0.9


def test_command_tells_what_it_cannot_read_in_one_line(tmp_path, capsys):
    (tmp_path / "data.csv").write_text("a;b\n1;2\n")
    assert main(["--data", str(tmp_path / "data.csv")]) == 2
    error = capsys.readouterr().err
    assert error.startswith("check: ") and error.count("\n") == 1


def test_slow_loops_of_several_sizes_beside_a_few_fast_ones_show_the_hysteresis(read):
    period_s, loops_v = 1e-3, []
    for frequency_hz, size_v, cycles in (
            (1.0, 20.0, 2), (1.0, 10.0, 1), (1.0, 5.0, 1), (10.0, 20.0, 5), (25.0, 20.0, 10)):
        turns = np.arange(0.0, cycles, frequency_hz * period_s)
        loops_v.append(0.5 * size_v * (1.0 - np.cos(2.0 * np.pi * turns)))
    voltage_v = np.concatenate(loops_v)
    fit = suitability_for(check_recording(
        read(voltage_v, 0.2 * voltage_v, period_s)), "hysteresis")
    assert fit.verdict == "partly" and "--dynamics" in fit.reason
