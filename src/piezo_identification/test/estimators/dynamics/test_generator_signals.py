# SPDX-License-Identifier: BSD-3-Clause
"""A stage in plain numpy under a generator that runs freely: exact steps at any instant."""

from dataclasses import replace

import numpy as np
import pytest

from piezo_identification.conditioning.generator_edges import generator_edges
from piezo_identification.conditioning.waveforms import square_wave
from piezo_identification.estimators.dynamics.fast_estimate import estimate_dynamics
from piezo_identification.estimators.dynamics.fast_signals import joined_record
from piezo_identification.estimators.dynamics.generator_signals import with_edges_between
from piezo_identification.identification.identify import identify
from piezo_models.linear.dynamics import CreepDynamics
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag

PERIOD_S, COUNT = 5e-5, 16_000
LAG_S = 4e-4
MODES = ((620.0, 0.02, 0.92), (1450.0, 0.015, 0.08))
NOISE = 2e-4
pytestmark = pytest.mark.long


def step_answer(time_s):
    """Lag, then modes side by side, a time after a unit step; 0 before it."""
    answer = np.zeros(time_s.shape)
    after = time_s > 0.0
    t = time_s[after]
    for hertz, damping, part in MODES:
        w = 2.0 * np.pi * hertz
        poles = np.array([-1.0 / LAG_S, w * (-damping + 1j * np.sqrt(1.0 - damping**2)),
                          w * (-damping - 1j * np.sqrt(1.0 - damping**2))])
        whole = np.ones(t.size)
        for i, pole in enumerate(poles):
            others = np.delete(poles, i)
            residue = w**2 / LAG_S / (pole * np.prod(pole - others))
            whole = whole + (residue * np.exp(pole * t)).real
        answer[after] += part * whole
    return answer


def record(edges_s, delay_s=0.0, seed=3):
    """Rows of a level that changes between 0 and 1 at any instants, read a delay late."""
    rows_s = np.arange(COUNT) * PERIOD_S
    displacement, answered = np.zeros(COUNT), 0.3
    for index, edge_s in enumerate(edges_s):
        since_s = rows_s - delay_s - edge_s
        near = (since_s > 0.0) & (since_s < answered)
        sign = 1.0 - 2.0 * (index % 2)
        displacement[near] += sign * step_answer(since_s[near])
        displacement[since_s >= answered] += sign
    level = np.searchsorted(edges_s, rows_s, side="right") % 2
    return Recording(
        __file__, 1.0 / PERIOD_S, np.arange(COUNT), np.full(COUNT, PERIOD_S),
        20.0 + 30.0 * level,
        13.0 * displacement + 13.0 * NOISE * np.random.default_rng(seed).normal(size=COUNT),
        np.full(COUNT, Flag.PLAYING, dtype=np.uint32))


def edges_s(rows_of_period, duty, first_row):
    rises = first_row + rows_of_period * np.arange(int((COUNT - first_row) / rows_of_period) + 1)
    edges = np.sort(np.concatenate([rises, rises + duty * rows_of_period]))
    return edges[edges < COUNT - 1] * PERIOD_S


@pytest.mark.parametrize(("rows_of_period", "duty", "delay_rows"), [
    pytest.param(602.625, 0.5, 0.0, id="edges at eighths"),
    pytest.param(411.3719, 0.43, 2.6, id="edges anywhere")])
def test_what_follows_the_edges_of_a_free_running_generator_is_told_to_the_noise(
        rows_of_period, duty, delay_rows):
    recording = record(edges_s(rows_of_period, duty, 120.317), delay_rows * PERIOD_S)
    estimate = estimate_dynamics([recording], CreepDynamics())
    assert estimate.residual_rms < 1.02 * 13.0 * NOISE
    assert [effect.name for effect in estimate.effects].count("sensor_lag") == 0
    off = (estimate.delay.samples - delay_rows) * PERIOD_S
    assert abs(off) < 4.0 * estimate.delay.standard_deviation_s
    assert estimate.delay.is_significant == bool(delay_rows)
    s = 2j * np.pi * np.linspace(1.0, 2500.0, 400)
    truth = sum(part / ((s / (2 * np.pi * hertz))**2 + 2 * damping * s / (2 * np.pi * hertz) + 1.0)
                for hertz, damping, part in MODES) / (LAG_S * s + 1.0)
    found = estimate.model.response(s.imag / (2.0 * np.pi), [
        effect for effect in estimate.effects if effect.name == "vibration_mode"])
    assert np.abs(found - truth).max() < 2e-3 * np.abs(truth).max()


def test_the_dynamics_under_a_free_running_generator_are_adequate():
    recording = record(edges_s(602.625, 0.5, 120.317))
    adequacy = identify(dynamics=recording).adequacy["dynamics"]
    assert adequacy["verdict"] == "adequate"
    assert adequacy["ratio"] < 1.05


def test_the_period_is_found_where_only_later_edges_are_fitted():
    """The period then turns about another instant than the mean of all edges."""
    edges = edges_s(411.3719, 0.43, 120.317)
    recording = record(edges, 2.6 * PERIOD_S)
    wave = square_wave(recording)
    timed = with_edges_between(
        joined_record([recording], [wave.level], [6000], CreepDynamics()),
        [generator_edges(wave)])
    off = timed.input.early[wave.steps] - (wave.steps - edges / PERIOD_S)
    assert np.ptp(off) < 3e-3


def test_a_first_level_that_the_stage_does_not_come_back_to_makes_no_modes():
    """The first step is then higher than all others, and rings on for longer than they do."""
    edges = edges_s(602.625, 0.5, 120.317)
    upward, other = record(edges), record(edges, seed=4)
    higher_um = 1.0 - step_answer(np.arange(COUNT) * PERIOD_S - edges[0])
    downward = replace(
        other, voltage_v=70.0 - other.voltage_v,
        displacement_um=13.0 - other.displacement_um - higher_um)
    estimate = estimate_dynamics([upward, downward], CreepDynamics())
    found = [*estimate.model.mode_frequencies_rad_per_s, *(
        effect.frequency_rad_per_s for effect in estimate.effects
        if effect.name == "vibration_mode")]
    np.testing.assert_allclose(
        np.sort(found), [2.0 * np.pi * hertz for hertz, _, _ in MODES], rtol=1e-3)
    assert estimate.residual_rms < 1.02 * 13.0 * NOISE
