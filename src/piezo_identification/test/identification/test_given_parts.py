# SPDX-License-Identifier: BSD-3-Clause
"""Whatever is given is identified: one kind alone, several of a kind, gaps, few points."""

from dataclasses import replace

import numpy as np
import pytest

from piezo_identification.commands.identify_command import main as identify_main
from piezo_identification.identification.estimated_loops import DensityOptions
from piezo_identification.identification.identify import identify
from piezo_models.model_file import load_model

pytestmark = pytest.mark.usefixtures("without_search")


def loops(tops_v, points):
    """Triangles from 0 V, so many points each."""
    way = np.concatenate([np.linspace(0.0, 1.0, points // 2, endpoint=False),
                          np.linspace(1.0, 0.0, points - points // 2, endpoint=False)])
    return np.append(np.concatenate([top * way for top in tops_v]), 0.0)


def relative_error(model, stage, voltage_v):
    truth = stage.hysteresis(voltage_v)
    error = model.hysteresis.simulate(voltage_v) - truth
    return np.std(error) / np.ptp(truth)


@pytest.fixture(scope="module")
def static(foreign_stage):
    return foreign_stage()


def test_62_points_of_static_loops_are_enough(static, record):
    points = loops([80.0, 60.0, 40.0], 21)[:62]
    identified = identify(hysteresis=record(static, points, 1.0, noise_um=0.05))
    unseen_v = np.concatenate([loops([80.0, 70.0, 50.0, 30.0], 400)])
    assert relative_error(identified.model, static, unseen_v) < 0.01


def test_jumps_between_many_levels_show_the_hysteresis(static, record):
    """A tenth of the jumps are larger than two thirds of the range."""
    known_v, unseen_v = (
        np.append([0.0, 80.0, 0.0], np.random.default_rng(seed).uniform(0.0, 80.0, 120))
        for seed in (5, 6))
    identified = identify(hysteresis=record(static, np.repeat(known_v, 4), 0.5, noise_um=0.01))
    assert relative_error(identified.model, static, unseen_v) < 0.005


def test_samples_of_a_clipped_sensor_are_left_out(static, record):
    recorded = record(static, loops(np.arange(80.0, 0.0, -10.0), 300), 0.1, noise_um=0.01)
    highest_um = np.quantile(recorded.displacement_um, 0.9)
    notes = []
    identified = identify(hysteresis=replace(recorded, displacement_um=np.minimum(
        recorded.displacement_um, highest_um)), note=notes.append)
    assert sum("the sensor is clipped there" in note for note in notes) == 1
    assert identified.adequacy["hysteresis"]["verdict"] == "adequate"
    unseen_v = loops([55.0, 45.0, 35.0], 300)
    assert relative_error(identified.model, static, unseen_v) < 2e-3


@pytest.mark.long
def test_several_recordings_and_gaps_are_one_identification(static, record):
    first = record(static, loops([80.0, 60.0], 300), 0.1, seed=1)
    second = record(static, loops([70.0, 80.0, 40.0, 20.0], 300), 0.1, seed=2)
    second = replace(second, displacement_um=second.displacement_um + 3.0)
    cut = np.ones(second.voltage_v.size, dtype=bool)
    cut[500:560] = False
    second = replace(second.select(cut), gaps=[(500, 60)])
    identified = identify(hysteresis=[first, second])
    unseen_v = loops([80.0, 75.0, 50.0, 30.0], 400)
    assert relative_error(identified.model, static, unseen_v) < 3e-3
    assert len(identified.recordings) == 2


def test_all_stretches_of_a_validation_with_gaps_count_but_for_a_few_samples(static, record):
    given = record(static, loops([80.0, 60.0, 40.0], 300), 0.1, seed=1)
    unseen = record(static, loops([80.0, 75.0, 50.0, 30.0], 400), 0.1, seed=2)
    index = unseen.sample_index
    kept = (index < 700) | (index >= 760) & (index < 1200) | (index >= 1595)
    cut = replace(unseen.select(kept), gaps=[(700, 60), (1200, 395)])
    # The first stretch is true, the second 10 % too large; the third, of six samples, is left out.
    second = (cut.sample_index >= 760) & (cut.sample_index < 1200)
    wrong = replace(cut, displacement_um=np.where(second, 1.1, 1.0) * cut.displacement_um)
    error = identify(hysteresis=given, validation=wrong,
                     density=DensityOptions(40, 1e-10, 1e-10)).errors["e_y_percent"]
    first, larger = wrong.displacement_um[:700], wrong.displacement_um[700:1140]
    alone = 100.0 * (1.0 - 1.0 / 1.1)
    share = np.sum((larger - larger.mean()) ** 2) / (
        np.sum((larger - larger.mean()) ** 2) + np.sum((first - first.mean()) ** 2))
    assert error == pytest.approx(alone * np.sqrt(share), rel=0.1)


@pytest.mark.long
def test_creep_alone_gives_a_model_with_its_hysteresis(foreign_stage, record):
    stage = foreign_stage(((0.05, 0.04), (0.8, 0.03)))
    voltage_v = np.concatenate([loops([80.0, 50.0], 600), np.repeat([70.0, 20.0], 1000), [0.0]])
    model = identify(creep=record(stage, voltage_v, 0.05),
                     density=DensityOptions(40, 1e-10, 1e-10)).model
    assert len(model.creep.poles_rad_per_s) == 2
    assert relative_error(model, stage, loops([80.0, 60.0], 300)) < 0.01


@pytest.mark.long
def test_fast_cycles_give_the_hysteresis_where_the_dynamics_are_known(foreign_stage, record):
    stage = foreign_stage((), 4e-4, 3000.0, 0.05)
    square = np.tile(np.repeat([20.0, 60.0], 150), 30).astype(float)
    cycles = loops([80.0, 70.0, 60.0, 50.0, 40.0, 30.0, 20.0, 10.0] * 2, 250)
    cycles = 40.0 - 40.0 * np.cos(np.pi * cycles / 80.0)
    model = identify(dynamics=record(stage, square, 1e-4),
                     hysteresis=record(stage, cycles, 1e-4),
                     density=DensityOptions(40, 1e-10, 1e-10)).model
    unseen_v = loops([80.0, 65.0, 45.0, 30.0], 400)
    assert relative_error(model, stage, unseen_v) < 5e-3


@pytest.mark.parametrize("sign", [pytest.param(1.0, marks=pytest.mark.long), -1.0])
def test_a_frequency_response_alone_gives_a_line(sign, tmp_path, capsys):
    frequency_hz = np.geomspace(5.0, 900.0, 120)
    s = 2j * np.pi * frequency_hz
    gain = sign * 0.4 / ((4e-4 * s + 1.0) * (s**2 / 3000.0**2 + 0.1 * s / 3000.0 + 1.0))
    path = tmp_path / "response.csv"
    np.savetxt(path, np.column_stack([frequency_hz, gain.real, gain.imag]), delimiter=",",
               header="frequency_hz,gain_re,gain_im", comments="")
    output = tmp_path / "model.json"
    assert identify_main(["--dynamics", str(path), "--output", str(output), "--no-report",
                          "--creep-pairs", "0", "--modes", "1", "--antiresonances", "0"]) == 0
    hysteresis = load_model(output).model.hysteresis
    rise_um = np.diff(hysteresis.simulate(np.array([0.0, 10.0])))
    assert rise_um == pytest.approx(4.0, rel=1e-3)
    assert hysteresis.simulate(np.array([0.0])) == pytest.approx(0.0, abs=1e-9)
    printed = capsys.readouterr().out
    assert "shows no hysteresis" in printed and "inadequate" not in printed
    assert ("falls as the voltage rises" in printed) == (sign < 0.0)


def test_the_command_takes_several_files_grid_and_weights(static, record, save_csv, tmp_path):
    files = []
    for number, tops in enumerate(([80.0, 60.0], [80.0, 40.0])):
        recording = record(static, loops(tops, 200), 0.1)
        files.append(str(save_csv(tmp_path / f"{number}.csv", recording.time_s,
                                  recording.voltage_v, recording.displacement_um)))
    output = tmp_path / "model.json"
    assert identify_main(["--hysteresis", *files, "--grid", "20", "--smoothing", "1e-10",
                          "--translation-weight", "1e-8", "--no-report",
                          "--output", str(output)]) == 0
    identified = load_model(output)
    assert identified.model.hysteresis.density_um_per_v2.shape == (20, 20)
    assert [each["path"] for each in identified.recordings] == files


@pytest.mark.parametrize("arguments, said", [
    ([], "there is nothing to identify"),
    (["--smoothing", "-1"], "there is nothing to identify"),
])
def test_what_cannot_be_identified_is_refused(arguments, said, tmp_path, capsys):
    assert identify_main([*arguments, "--output", str(tmp_path / "model.json")]) == 2
    assert said in capsys.readouterr().err
