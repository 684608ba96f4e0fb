# SPDX-License-Identifier: BSD-3-Clause
import control
import numpy as np
import pytest

from piezo_identification.conditioning.settling import (
    USUAL_SETTLING_S,
    first_settled,
    held_delay_s,
    low_frequency_delay_s,
    rings_unresolved,
    settling_time_s,
    slow_delay_s,
    slow_dynamics,
    unresolved_ringing,
)
from piezo_models.effects.delay import Delay
from piezo_models.effects.sensor_lag import SensorLag
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.linear.dynamics import ElectricVibrationDynamics, simulate_linear, zoh


def test_the_delay_is_the_slope_of_the_phase_at_low_frequency(plant):
    phase = np.angle(plant.dynamics.response(0.1))
    assert low_frequency_delay_s(plant.dynamics) == pytest.approx(-phase / (0.2 * np.pi), rel=1e-5)
    with_zeros = ElectricVibrationDynamics(1e-3, (3000.0,), (0.1,), (2000.0,), (0.3,))
    phase = np.angle(with_zeros.response(0.1))
    assert low_frequency_delay_s(with_zeros) == pytest.approx(-phase / (0.2 * np.pi), rel=1e-4)


def test_effects_delay_slow_signals_by_the_slope_of_their_phase(plant):
    modes = (VibrationMode(5400.0, 0.3, 0.2), VibrationMode(8300.0, 0.015, -0.04),
             VibrationMode(300.0, 0.1, 0.005))
    effects = (*modes, Delay(2e-4), SensorLag(1e-4))
    response = plant.dynamics.response(0.1, modes) * np.exp(-2j * np.pi * 0.1 * 2e-4) / (
        1.0 + 2j * np.pi * 0.1 * 1e-4)
    slow = slow_dynamics(plant.dynamics, effects)
    # The last one is too small to wait for.
    assert slow.parallel_modes == modes[:2]
    assert low_frequency_delay_s(slow) + slow_delay_s(plant.dynamics, effects) == pytest.approx(
        -np.angle(response) / (0.2 * np.pi), rel=1e-5)


def test_after_the_settling_time_a_step_response_stays_at_its_end(plant):
    response = simulate_linear(zoh(plant.dynamics.state_space(), 25e-6), np.ones(4000))
    settled = round(settling_time_s(plant.dynamics) / 25e-6)
    assert np.abs(response[settled:] - 1.0).max() < 1e-4
    assert np.abs(response[settled // 2 :] - 1.0).max() > 1e-4


def test_a_mode_that_rings_for_long_leaves_most_of_a_recording():
    time_s = np.arange(4000) * 25e-6
    settled = ElectricVibrationDynamics(0.0, (1e4,), (0.1,))
    assert time_s[first_settled(settled, time_s)] == pytest.approx(
        settling_time_s(settled), abs=25e-6)
    assert first_settled(ElectricVibrationDynamics(0.0, (1e4,), (1e-5,)), time_s) == 1000


def test_a_parallel_mode_that_is_the_whole_displacement_is_waited_for_as_one_in_series():
    time_s = np.arange(4000) * 25e-6
    in_series = ElectricVibrationDynamics(0.0, (1e4,), (0.1,))
    alone = ElectricVibrationDynamics()
    count = first_settled(in_series, time_s)
    assert count > 100
    assert first_settled(alone, time_s, (VibrationMode(1e4, 0.1, 1.0),)) == count
    assert first_settled(slow_dynamics(alone, (VibrationMode(1e4, 0.1, 1.0),)), time_s) == count
    assert first_settled(alone, time_s, (VibrationMode(1e4, 0.1, 1e-3),)) == 0


def test_a_mode_that_an_antiresonance_cancels_is_not_waited_for():
    beside = ElectricVibrationDynamics(0.0, (1e3, 1e4), (1e-5, 0.1), (1.0001e3,), (1e-5,))
    assert settling_time_s(beside) == pytest.approx(
        settling_time_s(ElectricVibrationDynamics(0.0, (1e4,), (0.1,))))


def test_without_dynamics_nothing_is_late():
    static = ElectricVibrationDynamics()
    assert low_frequency_delay_s(static) == 0.0
    assert settling_time_s(static) == 0.0


@pytest.mark.parametrize("period_s", [1e-6, 25e-6, 1e-3, 0.05])
def test_delay_of_held_voltages_is_that_of_a_slow_ramp(period_s):
    dynamics = ElectricVibrationDynamics(2e-4, (4900.0,), (0.3,))
    system = control.sample_system(dynamics.state_space(), period_s, "zoh")
    count = int(60e-3 / period_s) + 20
    times = period_s * np.arange(count)
    response = control.forced_response(system, times, times).outputs
    assert held_delay_s(dynamics, period_s) == pytest.approx(times[-1] - response[-1], rel=1e-6)


def test_delay_of_fast_dynamics_is_the_whole_hold():
    fast = ElectricVibrationDynamics(1e-6, (1e5,), (0.5,))
    assert held_delay_s(fast, 0.05) == pytest.approx(0.05, rel=1e-9)


def test_modes_beside_each_other_ring_in_a_staircase_with_their_parts_only():
    """Every other image of the rows falls on a mode of a hundredth, and hardly shows."""
    modes = (VibrationMode(1222.0, 0.023, 0.0104), VibrationMode(1320.0, 0.03, 0.89),
             VibrationMode(4775.0, 0.02, 0.1))
    effects, dynamics, period_s = (Delay(1e-4), *modes), ElectricVibrationDynamics(8e-4), 0.01
    slow = slow_dynamics(dynamics, effects)
    ramp = period_s * np.arange(200)
    late_s = ramp[-1] - simulate_linear(zoh(dynamics.state_space(modes), period_s), ramp)[-1]
    assert held_delay_s(slow, period_s) == pytest.approx(late_s, rel=1e-6)
    assert slow_delay_s(dynamics, effects) == pytest.approx(1e-4)
    frequency_hz = np.array([1.0, 194.0, 300.0])
    assert slow.response(frequency_hz) == pytest.approx(dynamics.response(frequency_hz, modes))


@pytest.mark.parametrize("participation, is_waited_for", [(0.02, False), (0.5, True)])
def test_a_slow_mode_is_waited_for_only_if_it_stands_out_beside_the_others(
        participation, is_waited_for):
    others = VibrationMode(2e4, 0.01, 0.9), VibrationMode(4e4, 0.02, 0.05)
    slow = VibrationMode(1e3, 1e-3, participation)
    settled_s, without_s = (settling_time_s(slow_dynamics(ElectricVibrationDynamics(), modes))
                            for modes in ((*others, slow), others))
    assert (settled_s > 10.0 * without_s) == is_waited_for


def test_a_lag_far_slower_than_the_modes_behind_it_is_waited_for():
    behind_lag = ElectricVibrationDynamics(5e-3, (2e4,), (0.02,))
    assert settling_time_s(behind_lag) == pytest.approx(-5e-3 * np.log(1e-5), rel=1e-6)


def test_a_faint_slow_mode_is_waited_for_as_long_as_usual():
    fast = VibrationMode(2e5, 0.1, 0.9)
    slow = VibrationMode(1e3, 1e-3, 0.02)
    settled_s, alone_s = (settling_time_s(slow_dynamics(ElectricVibrationDynamics(), modes))
                          for modes in ((fast, slow), (fast,)))
    assert alone_s < 1e-3
    assert settled_s == USUAL_SETTLING_S


RINGING = ElectricVibrationDynamics(0.0, (1948.0,), (0.015,))
PARALLEL = slow_dynamics(ElectricVibrationDynamics(), (VibrationMode(1948.0, 0.015, 0.9),))


@pytest.mark.parametrize("dynamics, period_s, rows", [
    (RINGING, 0.02, 7), (PARALLEL, 0.02, 7), (RINGING, 1e-4, 0), (RINGING, 0.001, 125),
    (ElectricVibrationDynamics(), 0.02, 0)])
def test_rows_that_cannot_resolve_the_ringing_after_a_jump_are_marked(dynamics, period_s, rows):
    voltage_v = np.repeat([0.0, 80.0, 0.0], 500)
    marked = np.flatnonzero(rings_unresolved(dynamics, voltage_v, period_s))
    expected = np.concatenate([jump + 1 + np.arange(rows) for jump in (500, 1000)])
    np.testing.assert_array_equal(marked, expected)


def test_a_smooth_voltage_marks_no_rows():
    assert not rings_unresolved(RINGING, np.linspace(0.0, 90.0, 1000), 0.02).any()


@pytest.mark.parametrize("dynamics", [RINGING, PARALLEL])
def test_ringing_of_any_amplitude_and_phase_is_a_sum_of_the_signals(dynamics):
    period_s, voltage_v = 0.02, np.repeat([0.0, 80.0, 30.0], 500)
    pole = 1948.0 * (-0.015 + 1j * np.sqrt(1.0 - 0.015**2))
    time_s = period_s * np.arange(voltage_v.size)
    rings = sum((time_s > period_s * jump) * jumped_v * np.real(
        (0.3 - 0.8j) * np.exp(pole * (time_s - period_s * jump)))
        for jump, jumped_v in ((500, 80.0), (1000, -50.0)))
    signals = unresolved_ringing(dynamics, voltage_v, period_s)
    assert signals.shape == (1500, 2)
    sizes = np.linalg.lstsq(signals, rings, rcond=None)[0]
    np.testing.assert_allclose(signals @ sizes, rings, atol=1e-9)


@pytest.mark.parametrize("dynamics, period_s, voltage_v", [
    (RINGING, 1e-4, np.repeat([0.0, 80.0], 500)), (RINGING, 0.02, np.linspace(0.0, 90.0, 1000)),
    (ElectricVibrationDynamics(), 0.02, np.repeat([0.0, 80.0], 500))])
def test_ringing_that_rows_resolve_or_that_is_not_excited_is_not_free(
        dynamics, period_s, voltage_v):
    assert unresolved_ringing(dynamics, voltage_v, period_s).shape[1] == 0
