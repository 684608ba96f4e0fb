# SPDX-License-Identifier: BSD-3-Clause
"""A coupled mode adds a pair of poles with any residue."""

from dataclasses import replace

import numpy as np
import pytest

from piezo_models.effects.coupled_mode import CoupledMode, modes_in_parallel, modes_in_series
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.linear.dynamics import ElectricVibrationDynamics

LAG_S = 3e-5
MODES = (CoupledMode(7500.0, 0.02, 0.7, -0.3), CoupledMode(9000.0, 1.7, -0.4, 0.1))


def partial_fractions(s):
    """The same dynamics by hand: a lag, what follows at once, and two branches."""
    total = 1.0 - 0.7 + 0.4
    for w, d, p, v in ((7500.0, 0.02, 0.7, -0.3), (9000.0, 1.7, -0.4, 0.1)):
        total = total + (p + v * s / w) / (1.0 + 2.0 * d * s / w + (s / w) ** 2)
    return total / (1.0 + LAG_S * s)


def test_state_space_and_response_are_the_partial_fractions():
    dynamics, frequency_hz = ElectricVibrationDynamics(LAG_S), np.geomspace(1.0, 1e4, 50)
    wanted = partial_fractions(2j * np.pi * frequency_hz)
    system = dynamics.state_space(MODES)
    assert system(2j * np.pi * frequency_hz, squeeze=True) == pytest.approx(wanted, rel=1e-10)
    assert dynamics.response(frequency_hz, MODES) == pytest.approx(wanted, rel=1e-10)


def test_without_a_velocity_it_is_a_vibration_mode():
    dynamics = ElectricVibrationDynamics(LAG_S, (4000.0,), (0.1,))
    frequency_hz = np.geomspace(1.0, 1e4, 50)
    pair = (dynamics.response(frequency_hz, [kind(7500.0, 0.02, 0.7)])
            for kind in (CoupledMode, VibrationMode))
    assert next(pair) == pytest.approx(next(pair))


def test_its_delay_of_slow_signals_is_that_of_its_branch():
    step = 1e-3
    for mode in MODES:
        slope = (mode.branch_response(np.array([1j * step])).imag / step).item()
        assert mode.branch_delay_s() == pytest.approx(-slope, rel=1e-6)


def test_alone_it_acts_as_beside_what_follows_at_once():
    time_s = 1e-5 * np.arange(20_000)
    signal = np.sin(2.0 * np.pi * 50.0 * time_s)
    expected = (1.0 - 0.7 + CoupledMode(7500.0, 0.02, 0.7, -0.3).branch_response(
        np.array([100j * np.pi]))).item()
    behind = MODES[0].apply(signal, 1e-5)[10_000:]
    wave = np.exp(100j * np.pi * time_s[10_000:])
    assert 2.0 * np.mean(behind * wave.conj()) * 1j == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(("dampings", "zeros"), [
    ((0.02, 0.3, 0.1), ((4000.0, 0.05), (7000.0, 0.3))),
    ((0.02, 1.7, 0.1), ((4000.0, 0.05),)),
    ((0.7, 0.01, 3.0), ()),
])
def test_modes_in_parallel_are_those_in_series(dampings, zeros):
    series = ElectricVibrationDynamics(
        LAG_S, (3000.0, 5000.0, 9000.0), dampings, *(zip(*zeros, strict=True) if zeros else ()))
    modes = modes_in_parallel(series)
    frequency_hz = np.geomspace(1.0, 1e4, 50)
    assert sum(mode.participation for mode in modes) == pytest.approx(1.0)
    assert ElectricVibrationDynamics(LAG_S).response(frequency_hz, modes) == pytest.approx(
        series.response(frequency_hz), rel=1e-9)
    again, lead_s = modes_in_series(modes, 1e5)
    assert again.response(frequency_hz) == pytest.approx(
        replace(series, time_constant_s=0.0).response(frequency_hz), rel=1e-9)
    assert lead_s == pytest.approx(0.0, abs=1e-12)


def test_a_real_zero_of_parallel_modes_is_a_lead():
    mode = CoupledMode(7500.0, 0.02, 1.0, 7500.0 * LAG_S)
    series, lead_s = modes_in_series([mode], 1e5)
    assert series == ElectricVibrationDynamics(0.0, (7500.0,), (0.02,))
    assert lead_s == pytest.approx(LAG_S)


def test_zeros_in_the_right_half_plane_have_no_antiresonance():
    modes = modes_in_parallel(ElectricVibrationDynamics(0.0, (3000.0, 9000.0), (0.02, 0.02)))
    wrong = [replace(mode, velocity_participation=mode.velocity_participation - 0.3)
             for mode in (CoupledMode(3000.0, 0.02, 0.6), CoupledMode(9000.0, 0.02, 0.4))]
    assert modes_in_series(modes, 1e5) is not None
    assert modes_in_series(wrong, 1e5) is None


def test_modes_that_are_nearly_equal_have_no_parts_in_parallel():
    with pytest.raises(ValueError, match="participation"):
        modes_in_parallel(ElectricVibrationDynamics(LAG_S, (3000.0, 3000.001), (0.02, 0.02)))
