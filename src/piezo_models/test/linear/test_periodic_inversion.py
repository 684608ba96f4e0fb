# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from piezo_models.linear.dynamics import simulate_linear, zoh
from piezo_models.linear.periodic_inversion import invert_linear_periodic

PERIOD_S = 25e-6


def steady_periods(stage, period, repeats):
    """Return the last period of the output for a repeated input whose mean is in equilibrium."""
    system = stage.linear()
    discrete = zoh(system, PERIOD_S)
    mean = period.mean()
    output = simulate_linear(discrete, np.tile(period - mean, repeats))[-period.size :]
    return output + mean * system.dcgain()


@pytest.mark.parametrize("frequency_hz", [40, 100, 500, 1000])
def test_held_inverse_gives_the_reference(stage, frequency_hz):
    samples = 40_000 // frequency_hz
    phase = 2 * np.pi * np.arange(samples) / samples
    reference = 30 + 20 * np.sin(phase) + 3 * np.cos(2 * phase)
    inverse = invert_linear_periodic(reference, stage.linear(), PERIOD_S)
    without_creep = stage.dynamics.state_space()
    through = simulate_linear(
        zoh(without_creep, PERIOD_S),
        np.tile(invert_linear_periodic(reference, without_creep, PERIOD_S), frequency_hz),
    )[-samples:]
    np.testing.assert_allclose(through, reference, atol=1e-9)
    # The slowest creep takes minutes to forget the start; what is left of it is small.
    reached = steady_periods(stage, inverse, frequency_hz)
    np.testing.assert_allclose(reached, reference, atol=2e-2)


def test_inverse_is_exact_in_the_periodic_state(stage):
    rng = np.random.default_rng(0)
    harmonics = np.zeros(501, dtype=complex)
    harmonics[:30] = rng.normal(size=30) + 1j * rng.normal(size=30)
    reference = np.fft.irfft(harmonics, 1000) * 1000
    inverse = invert_linear_periodic(reference, stage.linear(), PERIOD_S)
    discrete = zoh(stage.linear(), PERIOD_S)
    # The state to which the input returns after one period, from x = A^N x + driven.
    states = discrete.nstates
    whole = np.linalg.matrix_power(discrete.A, 1000)
    driven = np.zeros(states)
    for v in inverse:
        driven = discrete.A @ driven + discrete.B[:, 0] * v
    periodic = np.linalg.solve(np.eye(states) - whole, driven)
    np.testing.assert_allclose(
        simulate_linear(discrete, inverse, periodic), reference, atol=1e-8 * np.ptp(reference)
    )


def test_mean_is_divided_by_the_given_gain(stage):
    reference = 10 + np.sin(2 * np.pi * np.arange(400) / 400)
    settled = invert_linear_periodic(reference, stage.linear(), PERIOD_S)
    early = invert_linear_periodic(reference, stage.linear(), PERIOD_S, dc_gain=1.0)
    assert settled.mean() == pytest.approx(10 / stage.linear().dcgain(), rel=1e-9)
    assert early.mean() == pytest.approx(10.0, rel=1e-12)
    np.testing.assert_allclose(early - early.mean(), settled - settled.mean(), atol=1e-12)


def test_rounding_is_not_amplified(stage):
    samples = 400
    reference = 20 * np.sin(2 * np.pi * np.arange(samples) / samples)
    inverse = invert_linear_periodic(reference, stage.linear(), PERIOD_S)
    assert np.count_nonzero(np.abs(np.fft.rfft(inverse)) > 1e-9) == 1


def test_content_that_the_stage_does_not_pass_is_refused(stage):
    reference = np.sin(2 * np.pi * np.arange(400) / 400)
    reference += 1e-6 * np.cos(np.pi * np.arange(400))
    with pytest.raises(ValueError, match="content at 20000 Hz"):
        invert_linear_periodic(reference, stage.linear(), PERIOD_S)


def test_constant_reference_gives_constant_input(stage):
    inverse = invert_linear_periodic(np.full(8, 5.0), stage.linear(), PERIOD_S)
    np.testing.assert_allclose(inverse, 5.0 / stage.linear().dcgain(), rtol=1e-9)


def test_zero_reference_gives_zero_input(stage):
    assert not invert_linear_periodic(np.zeros(8), stage.linear(), PERIOD_S).any()


@pytest.mark.parametrize("reference", [[], [1.0, np.nan], [[1.0]]])
def test_senseless_references_are_refused(stage, reference):
    with pytest.raises(ValueError, match="the reference"):
        invert_linear_periodic(reference, stage.linear(), PERIOD_S)
