# SPDX-License-Identifier: BSD-3-Clause
"""Blocks of a stage, watched by a model: gaps, approaches, and what is kept for a diagnosis."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from piezo_identification.monitoring import explain_change as explaining
from piezo_identification.monitoring.explain_change import explain_change
from piezo_identification.monitoring.model_monitor import MonitorSettings
from piezo_identification.monitoring.stage_monitor import APPROACH_S, StageMonitor
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import load_model, save_model
from piezo_recorder.sample_block import Flag
from piezo_recorder.writing.convert import write_recording

RATE_HZ = 4000.0
PERIOD_S = 1.0 / RATE_HZ
TICK = 40
SETTINGS = MonitorSettings(block_s=0.1, learning_blocks=20)
CHANGE_S = 4.0
NOISE_UM = 0.009


def run_v(duration_s, amplitude_v=20.0):
    """A run that comes from rest by the lowest voltage, which wipes the past out."""
    approach = round(0.5 * APPROACH_S * RATE_HZ)
    time_s = PERIOD_S * np.arange(round(duration_s * RATE_HZ) - approach)
    way_v = np.interp(np.arange(approach), [0, approach / 2, approach], [0.0, -20.0, 50.0])
    return np.r_[way_v, 50.0 + amplitude_v * np.sin(2 * np.pi * 10.0 * time_s)
                 + 3.0 * np.sin(2 * np.pi * 430.0 * time_s)]


def measured_um(model, other, voltage_v, change=CHANGE_S, seed=1):
    """What a stage measures that is another one from a time on."""
    first, second = (one.simulate(voltage_v, PERIOD_S) for one in (model, other))
    noise_um = NOISE_UM * np.random.default_rng(seed).normal(size=voltage_v.size)
    return np.where(PERIOD_S * np.arange(voltage_v.size) < change, first, second) + noise_um


def with_mode(model, factor):
    frequencies = model.dynamics.mode_frequencies_rad_per_s
    return replace(model, dynamics=replace(model.dynamics, mode_frequencies_rad_per_s=(
        frequencies[0] * factor, *frequencies[1:])))


def fed(monitor, voltage_v, displacement_um, first=0, flags=int(Flag.TRACKING)):
    raised = []
    for begin in range(0, voltage_v.size, TICK):
        part = slice(begin, begin + TICK)
        raised += monitor.take(first + begin, PERIOD_S, voltage_v[part], displacement_um[part],
                               flags)
    return raised


@pytest.fixture
def changed(plant):
    voltage_v = run_v(7.0)
    return voltage_v, measured_um(plant, with_mode(plant, 1.03), voltage_v)


@pytest.fixture
def monitor(plant):
    return StageMonitor(plant, RATE_HZ, SETTINGS, kept_s=2.0)


def test_a_change_is_suspected_at_its_time_with_its_size_and_band(monitor, changed):
    first = fed(monitor, *changed)[0]
    assert CHANGE_S < first.at_s <= CHANGE_S + 1.0
    assert first.since_s == pytest.approx(CHANGE_S, abs=0.11)
    assert first.band_hz == (100.0, 1000.0)
    assert first.usual_rms_um == pytest.approx(NOISE_UM, rel=0.1)
    assert first.rms_um > 2.0 * first.usual_rms_um


def test_what_is_kept_is_bounded_and_brings_the_past_of_the_hysteresis(plant, monitor, changed):
    voltage_v, displacement_um = changed
    fed(monitor, voltage_v, displacement_um)
    assert monitor.samples_since(0.0) == 2.0 * RATE_HZ
    kept = monitor.recording(0.0)
    samples = int(np.count_nonzero(kept.tracking))
    assert samples == 2.0 * RATE_HZ
    assert np.array_equal(kept.voltage_v[-samples:], voltage_v[-samples:])
    assert np.array_equal(kept.displacement_um[-samples:], displacement_um[-samples:])
    whole_um = plant.hysteresis.simulate(voltage_v)
    assert plant.hysteresis.simulate(kept.voltage_v)[-samples:] == pytest.approx(
        whole_um[-samples:], abs=1e-9)
    with pytest.raises(ValueError, match="no samples of a run are kept since 9 s"):
        monitor.recording(9.0)


def test_the_change_is_explained_from_what_was_kept(plant, monitor, changed, tmp_path):
    first = fed(monitor, *changed)[0]
    save_model(tmp_path / "model.json", IdentifiedModel(plant, (-20.0, 120.0)))
    write_recording(monitor.recording(first.at_s), tmp_path / "after")
    found = explain_change(
        tmp_path / "model.json", tmp_path / "after", tmp_path / "found", first.usual_rms_um)
    assert "changed mode_1_frequency_rad_per_s" in found.sentence
    assert found.after_rms_um == pytest.approx(NOISE_UM, rel=0.05) != found.before_rms_um
    extended = load_model(found.extended_model)
    truth = with_mode(plant, 1.03).dynamics.mode_frequencies_rad_per_s
    assert extended.model.dynamics.mode_frequencies_rad_per_s == pytest.approx(truth, rel=3e-3)
    assert extended.recordings[-1]["path"] == str(tmp_path / "after")


def fed_runs(monitor, plant, runs_v):
    """Feed runs of one stage with rests between them; return the alarms."""
    rest_v, raised, first = np.zeros(200), [], 0
    displacement_um = measured_um(plant, plant, np.concatenate(
        [np.r_[voltage_v, rest_v] for voltage_v in runs_v]))
    for voltages_v in runs_v:
        for voltage_v, flags in ((voltages_v, int(Flag.TRACKING)), (rest_v, 0)):
            part = slice(first, first + voltage_v.size)
            raised += fed(monitor, voltage_v, displacement_um[part], first, flags)
            first += voltage_v.size
    return raised


def test_a_stage_that_stays_as_it_was_is_not_suspected_from_run_to_run(plant, monitor):
    assert fed_runs(monitor, plant, 4 * [run_v(2.5)]) == []
    assert not monitor.is_learning and monitor.lost_samples == 0


def test_another_reference_is_learned_anew_and_raises_nothing(plant, monitor):
    assert fed_runs(monitor, plant, [run_v(3.5), run_v(3.5, 30.0)]) == []
    assert not monitor.is_learning


def test_a_gap_is_counted_and_what_is_usual_learned_anew(plant, monitor, changed):
    voltage_v, displacement_um = changed
    fed(monitor, voltage_v[:14_000], displacement_um[:14_000])
    assert not monitor.is_learning
    fed(monitor, voltage_v[14_080:14_160], displacement_um[14_080:14_160], 14_080)
    assert monitor.is_learning and monitor.lost_samples == 80
    assert monitor.watched_until_s == 14_160 / monitor.sample_rate_hz
    assert monitor.samples_since(0.0) == 0


def test_slow_waveforms_move_the_model_along(plant, monitor):
    slow_v = np.array([10.0, 80.0, 30.0])
    monitor.take(0, 0.1, slow_v, slow_v, int(Flag.PLAYING))
    expected = plant.memory()
    plant.simulate(slow_v, 0.1, expected)
    top = expected.hysteresis.top
    assert monitor._monitor.past_v == pytest.approx(expected.hysteresis.extremes_v[: top + 1])
    assert monitor.take(1200, PERIOD_S, slow_v, slow_v, 0) == []
    assert monitor.lost_samples == 0


def test_the_process_of_an_explanation_leaves_its_result_or_why_there_is_none(
        tmp_path, monkeypatch):
    monkeypatch.setattr(explaining.os, "nice", lambda increment: None)  # here it is this process
    work = partial(explaining._work, str(tmp_path / "no.json"), "no", str(tmp_path), 0.01)
    work()
    result = json.loads((tmp_path / explaining.RESULT).read_text())
    assert result["sentence"].startswith("the change cannot be diagnosed: ")
    assert result["extended_model"] == ""
