# SPDX-License-Identifier: BSD-3-Clause
"""PID and PI tuning against plants whose ultimate point is known in closed form."""

import control
import numpy as np
import pytest

from piezo_controller.feedback.synthesis.generalised_plant import (
    design_plant,
    hysteresis_gain_range,
)
from piezo_controller.feedback.synthesis.h_infinity import is_stable
from piezo_controller.feedback.synthesis.ziegler_nichols import (
    NoOscillation,
    UltimatePoint,
    pid,
    proportional_integral,
    ultimate_point_by_relay,
    ultimate_point_by_response,
)
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics

pytestmark = pytest.mark.kernels

TICK_S, CLOCK_PERIOD_S = 1e-3, 25e-6


def test_response_gives_the_gain_and_period_of_two_delays():
    # z^-2 has the phase -180 degrees at a quarter of the rate, and the gain 1.
    plant = control.ss([[0, 0], [1, 0]], [[1], [0]], [[0, 1]], 0, TICK_S)
    ultimate = ultimate_point_by_response(plant, 0.5)
    assert ultimate.gain == pytest.approx(2.0, rel=1e-3)
    assert ultimate.period_s == pytest.approx(4 * TICK_S, rel=1e-3)


def test_loop_at_the_ultimate_gain_is_at_the_edge_of_stability(stage_model):
    plant, _ = design_plant(stage_model, TICK_S, CLOCK_PERIOD_S)
    gain_um_per_v = hysteresis_gain_range(stage_model)[1]
    ultimate = ultimate_point_by_response(plant, gain_um_per_v)
    for factor, stable in ((0.99, True), (1.01, False)):
        loop = factor * ultimate.gain * gain_um_per_v * plant
        assert is_stable(control.feedback(loop, 1)) == stable


def test_plant_whose_phase_never_crosses_has_no_ultimate_gain():
    with pytest.raises(NoOscillation, match="never crosses"):
        ultimate_point_by_response(control.ss([[0.5]], [[1]], [[1]], 0, TICK_S) *
                                   control.ss([], [], [], [[1.0]], TICK_S) + 2.0, 1.0)


@pytest.mark.parametrize("samples_per_tick", [1, 40])
def test_relay_oscillates_at_the_models_ultimate_frequency_behind_the_hysteresis_lag(
        stage_model, samples_per_tick):
    tick_s = samples_per_tick * CLOCK_PERIOD_S
    plant, _ = design_plant(stage_model, tick_s, CLOCK_PERIOD_S)
    linear = ultimate_point_by_response(plant, 1.0)
    relay = ultimate_point_by_relay(stage_model, samples_per_tick, CLOCK_PERIOD_S)
    assert relay.period_s == pytest.approx(linear.period_s, rel=0.1)
    # The hysteresis' gain for the relay's swing lies in its range, if for a describing function.
    assert 0.5 < linear.gain / relay.gain < 1.1


def test_relay_about_a_stage_that_answers_at_once_has_the_period_of_two_delays():
    stage = StageModel(PreisachModel.line(0.0, 100.0, 0.5), CreepDynamics((0.01,), (0.0102,)),
                       ElectricVibrationDynamics())
    relay = ultimate_point_by_relay(stage, 40, CLOCK_PERIOD_S)
    assert relay.period_s == pytest.approx(4 * TICK_S)
    assert relay.gain == pytest.approx(4.0 / np.pi / 0.5, rel=1e-2)  # of a square wave's swing


def test_relay_that_does_not_carry_the_stage_across_is_refused(stage_model):
    with pytest.raises(NoOscillation, match="does not oscillate"):
        ultimate_point_by_relay(stage_model, 40, CLOCK_PERIOD_S, swing=0.01)


def test_pid_is_the_thesis_transfer_function_in_the_band():
    gain, period_s = 2.62, 0.002
    controller = pid(UltimatePoint(gain, period_s), CLOCK_PERIOD_S)
    frequency_hz = np.array([1.0, 30.0, 300.0])
    s = 2j * np.pi * frequency_hz
    expected = 0.6 * gain * (1 + 2 / (period_s * s) + period_s / 8 * s / (0.005 * s + 1))
    found = controller(np.exp(s * CLOCK_PERIOD_S), squeeze=True)
    assert found == pytest.approx(expected, rel=1e-3)


def test_pi_is_3_20_with_the_gain_that_the_formula_gives():
    # (3.23) prints 1.01 z - 0.976 for these; the formula gives 1.004 z - 0.976.
    controller = proportional_integral(UltimatePoint(1.65, 0.0018), CLOCK_PERIOD_S)
    z = np.exp(0.3j)
    assert controller(z) == pytest.approx((1.00375 * z - 0.97625) / (z - 1), rel=1e-6)
