# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import replace

import numpy as np
import pytest

from piezo_identification.experiments.catalogue import StageLimits
from piezo_identification.experiments.relay_feedback import (
    RelayRun,
    relay,
    relay_oscillation,
)
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import (
    ElectricVibrationDynamics,
    continue_linear,
    equilibrium_state,
    zoh,
)
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag

SAMPLE_PERIOD_S = 25e-6
DYNAMICS = ElectricVibrationDynamics(0.0005, (3000.0, 5000.0), (0.5, 0.5))
HYSTERESIS = PreisachModel(
    -20.0, 120.0, np.tril(np.exp(-0.05 * np.subtract.outer(np.arange(40.0), np.arange(40.0)))
                          + np.eye(40)) * 0.05, 0.0)


class Stage:
    """Hysteresis and dynamics, in blocks of samples."""

    def __init__(self, dynamics=DYNAMICS, gain=1.0):
        self.system, self.gain = zoh(dynamics.state_space(), SAMPLE_PERIOD_S), gain
        self.memory = HYSTERESIS.memory()
        first_um = HYSTERESIS.simulate([0.0], self.memory)[0] * gain
        self.state = equilibrium_state(dynamics.state_space(), first_um)
        self.random = np.random.default_rng(1)

    def exchange(self, voltage_v):
        hysteresis_um = self.gain * HYSTERESIS.simulate(voltage_v, self.memory)
        displacement_um, self.state = continue_linear(self.system, hysteresis_um, self.state)
        return displacement_um + 0.009 * self.random.standard_normal(voltage_v.size)


def run(experiment, stage):
    """Return the recording of an experiment; each answer acts in the tick after the next."""
    answers, blocks, flags = [0.0, 0.0], [], []
    follower = RelayRun(experiment)
    size, once_v = experiment.samples_per_tick, experiment.feedforward_v
    for tick in range(experiment.ticks):
        planned_v = once_v[tick * size : (tick + 1) * size]
        held = planned_v.size < size
        planned_v = np.append(planned_v, np.full(size - planned_v.size, once_v[-1]))
        voltage_v = planned_v + answers.pop(0)
        displacement_um = stage.exchange(voltage_v)
        answers.append(follower.take(displacement_um))
        blocks.append((voltage_v, displacement_um))
        flags.append(Flag.TRACKING | (Flag.FEEDFORWARD_HELD if held else 0))
    assert follower.fraction == 1.0
    voltage_v, displacement_um = (np.concatenate(signals) for signals in zip(*blocks, strict=True))
    samples = voltage_v.size
    return Recording(
        "relay", 1.0 / SAMPLE_PERIOD_S, np.arange(samples), np.full(samples, SAMPLE_PERIOD_S),
        voltage_v, displacement_um, np.repeat(flags, size).astype(np.uint32))


@pytest.fixture(scope="module", params=[8, 40])
def case(request):
    experiment = relay(StageLimits(samples_per_tick=request.param))
    recording = run(experiment, Stage())
    return experiment, recording, relay_oscillation(recording, experiment)


def test_the_loop_oscillates_where_its_phase_with_the_declared_delay_is_minus_180_degrees(case):
    experiment, _, oscillation = case
    frequency_hz = np.geomspace(1e-2, 1e5, 20_000)
    phase = np.unwrap(np.angle(
        DYNAMICS.response(frequency_hz) * np.exp(-2j * np.pi * frequency_hz * experiment.delay_s)))
    expected_s = 1.0 / np.interp(np.pi, -phase, frequency_hz)
    # A relay that answers ticks has periods of whole ones; switching is late by half of one.
    assert 1.0 / oscillation.frequency_hz == pytest.approx(
        expected_s, abs=1.2 * experiment.tick_s + 0.03 * expected_s)


def test_the_response_of_the_stage_is_that_of_its_dynamics_times_the_gain_of_the_cycle(case):
    _, _, oscillation = case
    truth = DYNAMICS.response(oscillation.harmonics_hz) * oscillation.cycle_gain_um_per_v
    assert abs(oscillation.response_um_per_v[0] / truth[0] - 1.0) < 0.05
    assert np.abs(np.angle(oscillation.response_um_per_v[1] / truth[1])) < 0.2


def test_the_gains_of_the_hysteresis_are_those_of_the_cycle_and_of_the_secant(case):
    experiment, _, oscillation = case
    voltages_v = 50.0 + np.array([-7.0, 7.0])
    assert oscillation.largest_gain_um_per_v == pytest.approx(
        HYSTERESIS.gain_um_per_v(np.linspace(*voltages_v, 50))[1], rel=0.01)
    cycle_um = HYSTERESIS.everett_um(voltages_v[1], voltages_v[0])
    assert oscillation.cycle_gain_um_per_v == pytest.approx(cycle_um / 14.0, rel=0.01)
    assert oscillation.ultimate_gain_v_per_um == pytest.approx(
        oscillation.gain_margin / oscillation.largest_gain_um_per_v)


def test_the_voltage_stays_within_the_relay_and_is_the_plan_before(case):
    experiment, recording, _ = case
    planned_v = experiment.feedforward_v
    assert np.array_equal(recording.voltage_v[: planned_v.size], planned_v)
    assert np.abs(recording.voltage_v[planned_v.size :] - 50.0).max() == pytest.approx(7.0)
    assert np.abs(np.diff(planned_v)).max() / SAMPLE_PERIOD_S < 2e4


def test_the_summary_tells_the_delay_and_the_controller(case):
    experiment, _, oscillation = case
    assert f"declared delay of {1e3 * experiment.delay_s:.3g} ms" in oscillation.summary
    assert "PI controller (3.20)" in oscillation.summary


def test_a_stage_that_does_not_answer_fast_enough_is_refused():
    experiment = relay(StageLimits())
    slow = ElectricVibrationDynamics(0.0, (20.0,), (0.9,))
    with pytest.raises(ValueError, match="does not oscillate for 8 cycles"):
        relay_oscillation(run(experiment, Stage(slow)), experiment)


def test_the_delay_counts_mean_computation_and_hold():
    """Middle of the mean 0.5125 ms before its end, one tick of computing, half a tick of hold."""
    assert relay(StageLimits()).delay_s == pytest.approx(2.0125e-3)


def test_a_slew_limit_that_forbids_the_step_is_told():
    with pytest.raises(ValueError, match="needs a slew of"):
        relay(replace(StageLimits(), slew_limit_v_per_s=1e5))
