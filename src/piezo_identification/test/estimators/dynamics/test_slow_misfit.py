# SPDX-License-Identifier: BSD-3-Clause
"""A hysteresis that is not quite right is not taken for vibrations."""

import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))
from independent_stage import IndependentStage

from piezo_identification.estimators.dynamics import fast_creep, output_error
from piezo_identification.estimators.dynamics.fast_dynamics import ModeOrder
from piezo_identification.estimators.dynamics.fast_record import FastRecord
from piezo_identification.estimators.dynamics.fast_signals import joined_record
from piezo_models.linear.dynamics import CreepDynamics

PERIOD_S = 1e-4
MODE_RAD_PER_S = 2.0 * np.pi * 740.0


def growing_sine(rows=15_000):
    """Record of a sine whose amplitude grows, with noise on top, as laboratories play it."""
    random = np.random.default_rng(5)
    time_s = np.arange(rows) * PERIOD_S
    voltage_v = 60.0 * time_s / 1.5 * np.sin(2.0 * np.pi * 5.0 * time_s)
    voltage_v += 4.0 * np.repeat(random.normal(size=rows // 5), 5)
    stage = IndependentStage(1.6e-4, ((MODE_RAD_PER_S, 0.02, 1.0),), gains_um_per_v=(0.8,),
                             half_widths_v=(0.0,))
    recording = stage.record(voltage_v, PERIOD_S, 0.002, 5)
    return joined_record([recording], [voltage_v], [0], CreepDynamics())


def give_poles(monkeypatch, *modes):
    """Let the free fit of any record find these modes, by frequency (rad/s) and damping ratio."""
    poles = [-5e3]
    for frequency, damping in modes:
        pole = frequency * (-damping + 1j * np.sqrt(1.0 - damping**2))
        poles += [pole, np.conj(pole)]
    monkeypatch.setattr(fast_creep, "best_free_fit",
                        lambda coarse: SimpleNamespace(poles=np.array(poles)))


@pytest.mark.parametrize("low_hz, damping, mode_rad_per_s, needs_waves", [
    (5.0, 0.5, MODE_RAD_PER_S, True), (7.0, 0.1, MODE_RAD_PER_S, True),
    (5.0, 1e-5, MODE_RAD_PER_S, True), (400.0, 0.5, MODE_RAD_PER_S, False),
    (5.0, 0.5, 1.6 * np.pi / PERIOD_S, False)])
def test_a_record_may_hold_slow_motion_where_slow_poles_are_no_vibration(
        monkeypatch, low_hz, damping, mode_rad_per_s, needs_waves):
    record = growing_sine()
    give_poles(monkeypatch, (2.0 * np.pi * low_hz, damping), (mode_rad_per_s, 0.02))
    projected = fast_creep.project_out_slow_error(record)
    assert (projected.fixed.shape[1] > record.fixed.shape[1]) == needs_waves


def test_dynamics_have_about_the_gain_of_known_loops():
    record = replace(growing_sine(4000), is_driven_by_loops=True)
    ringing = record.fit(ModeOrder(1), np.log([1.6e-4, MODE_RAD_PER_S, 0.02]), 0.0)
    assert record.gain(ringing) == pytest.approx(0.8, rel=0.01)  # um/V of the stage
    assert not record.contradicts_loops(ringing)
    tenfold = replace(record, measured_um=10.0 * record.measured_um)
    assert tenfold.gain(ringing) == pytest.approx(10.0 * record.gain(ringing))
    assert tenfold.contradicts_loops(ringing)
    assert not replace(tenfold, is_driven_by_loops=False).contradicts_loops(ringing)


@pytest.mark.parametrize("most, is_refused", [(1e6, True), (1.0, False)])
def test_fewer_modes_are_used_where_others_contradict_the_loops(monkeypatch, most, is_refused):
    """They are if they explain the record nearly as well."""
    monkeypatch.setattr(output_error, "MOST_RESIDUAL", most)
    monkeypatch.setattr(FastRecord, "contradicts_loops", lambda _, fit: bool(
        fit.order.modes + fit.order.parallel))
    estimate = output_error.fit_output_error(growing_sine(800))
    modes = estimate.order.modes + estimate.order.parallel
    assert (modes == 0) == is_refused
    assert any(trial.refusal == output_error.CONTRADICTS
               for trial in estimate.trials) == is_refused


def test_slow_lines_of_a_long_record_are_left_out(monkeypatch):
    record = growing_sine(25_000)
    give_poles(monkeypatch, (2.0 * np.pi * 5.0, 0.5), (MODE_RAD_PER_S, 0.02))
    projected = fast_creep.project_out_slow_error(record)
    assert projected.fixed is record.fixed
    slowest = [each.at_lines(600).input.phases.min() for each in (record, projected)]
    assert slowest[0] < 0.01 * MODE_RAD_PER_S * PERIOD_S < 0.04 * MODE_RAD_PER_S * PERIOD_S
    assert slowest[1] > 0.04 * MODE_RAD_PER_S * PERIOD_S


def test_loops_are_as_fast_as_nearly_all_of_their_power():
    time_s = np.arange(20_000) * PERIOD_S
    sine = np.sin(2.0 * np.pi * 5.0 * time_s)
    noise = np.random.default_rng(1).normal(size=time_s.size)
    assert 30.0 < fast_creep.loop_rad_per_s(sine + 0.1 * noise, PERIOD_S) < 40.0
    assert fast_creep.loop_rad_per_s(noise, PERIOD_S) > 0.9 * np.pi / PERIOD_S


def test_slow_waves_hold_any_slow_motion():
    time_s = np.linspace(2.0, 3.0, 1000)
    basis = np.column_stack([np.ones_like(time_s), fast_creep.slow_waves(np.arange(1000), 20)])

    def left(signal):
        rest = signal - basis @ np.linalg.lstsq(basis, signal, rcond=None)[0]
        return np.std(rest) / np.std(signal)

    assert left((time_s - 2.0) ** 2 + np.exp(-3.0 * time_s)) < 0.02
    assert left(np.sin(2.0 * np.pi * 40.0 * time_s)) > 0.95
