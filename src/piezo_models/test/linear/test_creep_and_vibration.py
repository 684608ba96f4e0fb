# SPDX-License-Identifier: BSD-3-Clause
import control
import numpy as np
import pytest
import scipy.linalg
import scipy.signal

from piezo_models.linear.block_simulation import FEWEST, LENGTH
from piezo_models.linear.dynamics import (
    CreepDynamics,
    ElectricVibrationDynamics,
    answering_means,
    continue_linear,
    equilibrium_state,
    simulate_linear,
    zoh,
    zoh_response,
)

pytestmark = pytest.mark.kernels

PERIOD_S = 25e-6


@pytest.fixture
def antiresonant():
    return ElectricVibrationDynamics(
        0.0005, (2800.0, 4900.0, 9000.0), (0.7, 0.08, 0.02), (4000.0, 7000.0), (0.05, 0.03)
    )


@pytest.mark.parametrize("name", ["thesis_creep", "thesis_dynamics", "antiresonant"])
def test_state_space_has_the_response_of_the_formula(request, name):
    dynamics = request.getfixturevalue(name)
    frequency = np.logspace(-4, 4.3, 200)
    response = dynamics.response(frequency)
    np.testing.assert_allclose(
        dynamics.state_space()(2j * np.pi * frequency), response, rtol=1e-9, atol=1e-15
    )


def test_formulas_are_those_of_the_thesis(thesis_creep, antiresonant):
    s = 2j * np.pi * 700.0
    creep = np.prod(s + np.array(thesis_creep.zeros_rad_per_s)) / np.prod(
        s + np.array(thesis_creep.poles_rad_per_s)
    )
    assert thesis_creep.response(700.0) == pytest.approx(creep, rel=1e-12)
    zeros, zeta_zeros = (
        np.array(antiresonant.antiresonance_frequencies_rad_per_s),
        np.array(antiresonant.antiresonance_damping_ratios),
    )
    modes, zeta = (
        np.array(antiresonant.mode_frequencies_rad_per_s),
        np.array(antiresonant.damping_ratios),
    )
    shape = np.prod(s**2 + 2 * zeta_zeros * zeros * s + zeros**2) / np.prod(
        s**2 + 2 * zeta * modes * s + modes**2
    )
    shape *= np.prod(modes**2) / np.prod(zeros**2) / (0.0005 * s + 1)
    assert antiresonant.response(700.0) == pytest.approx(shape, rel=1e-12)


def test_creep_is_one_at_high_frequency_and_more_at_rest(thesis_creep):
    assert thesis_creep.response(1e9) == pytest.approx(1.0, abs=1e-9)
    ratio = np.prod(thesis_creep.zeros_rad_per_s) / np.prod(thesis_creep.poles_rad_per_s)
    assert thesis_creep.response(0.0) == pytest.approx(ratio, rel=1e-14)
    assert ratio == pytest.approx(1.111, abs=1e-3)


def test_electric_and_vibration_dynamics_have_unit_static_gain(antiresonant):
    assert antiresonant.response(0.0) == 1.0
    assert antiresonant.state_space().dcgain() == pytest.approx(1.0, rel=1e-12)


def test_response_takes_any_shape(thesis_creep, thesis_dynamics):
    frequency = np.ones((2, 3))
    assert thesis_creep.response(frequency).shape == (2, 3)
    assert thesis_dynamics.response(frequency).shape == (2, 3)
    assert zoh_response(thesis_dynamics.state_space(), frequency, PERIOD_S).shape == (2, 3)


def test_no_creep_passes_everything():
    none = CreepDynamics()
    assert none.response([0.0, 10.0]).tolist() == [1.0, 1.0]
    discrete = zoh(none.state_space(), PERIOD_S)
    assert simulate_linear(discrete, [1.0, 2.0]).tolist() == [1.0, 2.0]
    assert zoh_response(none.state_space(), [5.0], PERIOD_S).tolist() == [1.0]


def test_zoh_is_the_matrix_exponential(thesis_creep, thesis_dynamics):
    system = thesis_creep.state_space() * thesis_dynamics.state_space()
    n = system.nstates
    augmented = np.zeros((n + 1, n + 1))
    augmented[:n, :n], augmented[:n, n:] = system.A, system.B
    exact = scipy.linalg.expm(augmented * PERIOD_S)
    discrete = zoh(system, PERIOD_S)
    np.testing.assert_allclose(discrete.A, exact[:n, :n], rtol=0, atol=1e-15)
    np.testing.assert_allclose(discrete.B, exact[:n, n:], rtol=0, atol=1e-15)
    assert discrete.dt == PERIOD_S


def test_zoh_keeps_poles_and_static_gain_of_slow_creep_at_40_khz(thesis_creep, thesis_dynamics):
    system = thesis_creep.state_space() * thesis_dynamics.state_space()
    discrete = zoh(system, PERIOD_S)
    found = np.sort(np.log(np.linalg.eigvals(discrete.A)).real / PERIOD_S)[-5:]
    np.testing.assert_allclose(np.sort(-found), np.sort(thesis_creep.poles_rad_per_s), rtol=1e-7)
    static = zoh_response(system, 0.0, PERIOD_S)
    assert static == pytest.approx(thesis_creep.response(0.0), rel=1e-9)


def test_a_minute_of_creep_at_40_khz_is_the_analytic_step():
    pole, zero = 0.014, 0.015
    samples = 60 * 40_000
    discrete = zoh(CreepDynamics((pole,), (zero,)).state_space(), PERIOD_S)
    output = simulate_linear(discrete, np.ones(samples))
    time = np.arange(samples) * PERIOD_S
    exact = zero / pole + (1 - zero / pole) * np.exp(-pole * time)
    np.testing.assert_allclose(output, exact, rtol=0, atol=1e-9)


def test_simulation_is_that_of_scipy(thesis_creep, thesis_dynamics):
    discrete = zoh(thesis_creep.state_space() * thesis_dynamics.state_space(), PERIOD_S)
    rng = np.random.default_rng(0)
    samples, state = rng.normal(size=300), rng.normal(size=discrete.nstates)
    matrices = (discrete.A, discrete.B, discrete.C, discrete.D, PERIOD_S)
    _, expected, _ = scipy.signal.dlsim(matrices, samples, x0=state)
    np.testing.assert_allclose(
        simulate_linear(discrete, samples, state), expected[:, 0], rtol=1e-10, atol=1e-12
    )


def test_whole_cascade_is_measured_before_the_voltage_acts(thesis_creep, thesis_dynamics):
    discrete = zoh(thesis_creep.state_space() * thesis_dynamics.state_space(), PERIOD_S)
    output = simulate_linear(discrete, np.ones(10))
    assert output[0] == 0.0
    assert output[1] > 0.0


def test_continued_in_chunks_is_the_whole_to_the_bit(thesis_creep, thesis_dynamics):
    discrete = zoh(thesis_creep.state_space() * thesis_dynamics.state_space(), PERIOD_S)
    samples = np.random.default_rng(1).normal(size=100)
    state = np.zeros(discrete.nstates)
    chunks = []
    for chunk in np.split(samples, [1, 40]):
        output, state = continue_linear(discrete, chunk, state)
        chunks.append(output)
    assert np.array_equal(np.concatenate(chunks), simulate_linear(discrete, samples))


def test_equilibrium_lasts(thesis_creep, thesis_dynamics):
    system = thesis_creep.state_space() * thesis_dynamics.state_space()
    output = simulate_linear(
        zoh(system, PERIOD_S), np.full(10_000, 3.0), equilibrium_state(system, 3.0)
    )
    np.testing.assert_allclose(output, 3.0 * system.dcgain(), rtol=1e-10)


@pytest.mark.parametrize("frequency_hz", [100.0, 1000.0, 4000.0, 12_500.0])
def test_zoh_response_is_the_steady_state_of_a_simulation(antiresonant, frequency_hz):
    system = antiresonant.state_space()
    samples = np.arange(40_000)
    wave = np.exp(2j * np.pi * frequency_hz * PERIOD_S * samples)
    discrete = zoh(system, PERIOD_S)
    output = simulate_linear(discrete, wave.real) + 1j * simulate_linear(discrete, wave.imag)
    response = zoh_response(system, frequency_hz, PERIOD_S)
    np.testing.assert_allclose(output[-100:] / wave[-100:], response, rtol=1e-7, atol=1e-10)


def test_zoh_response_nears_the_continuous_one_at_low_frequency(thesis_dynamics):
    frequency = np.array([0.0, 0.1, 1.0])
    sampled = zoh_response(thesis_dynamics.state_space(), frequency, PERIOD_S)
    delayed = thesis_dynamics.response(frequency) * np.exp(-1j * np.pi * frequency * PERIOD_S)
    np.testing.assert_allclose(sampled, delayed, rtol=1e-8)


def test_zoh_response_is_the_same_across_blocks(thesis_dynamics):
    system = thesis_dynamics.state_space()
    frequency = np.linspace(0, 20_000, 4100)
    np.testing.assert_allclose(
        zoh_response(system, frequency, PERIOD_S)[-10:],
        zoh_response(system, frequency[-10:], PERIOD_S),
        rtol=1e-12,
    )


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: CreepDynamics((1.0, 2.0), (1.0,)), "one zero for each pole"),
        (lambda: CreepDynamics((-1.0,), (1.0,)), "poles_rad_per_s"),
        (lambda: CreepDynamics((1.0,), (np.nan,)), "zeros_rad_per_s"),
        (lambda: ElectricVibrationDynamics(-1e-3), "time_constant_s"),
        (lambda: ElectricVibrationDynamics(1e-3, (100.0,)), "damping ratios"),
        (lambda: ElectricVibrationDynamics(1e-3, (-100.0,), (0.1,)), "mode_frequencies"),
        (lambda: ElectricVibrationDynamics(1e-3, (), (), (10.0,), (0.1,)), "no more antireson"),
        (lambda: ElectricVibrationDynamics(1e-3, (1.0,), (1.0,), (10.0,)), "antiresonance damp"),
        (lambda: zoh(CreepDynamics((1.0,), (2.0,)).state_space(), 0.0), "sample_period_s"),
        (lambda: zoh(control.ss([[0.5]], [[1]], [[1]], [[0]], 1.0), 1.0), "discrete already"),
        (lambda: simulate_linear(CreepDynamics((1.0,), (2.0,)).state_space(), [1.0]), "zoh"),
    ],
)
def test_senseless_dynamics_are_refused(build, message):
    with pytest.raises(ValueError, match=message):
        build()


def test_mismatched_signals_are_refused(thesis_dynamics):
    discrete = zoh(thesis_dynamics.state_space(), PERIOD_S)
    with pytest.raises(ValueError, match="5 states"):
        simulate_linear(discrete, [1.0], [0.0])
    with pytest.raises(ValueError, match="one sequence"):
        simulate_linear(discrete, [[1.0]])
    with pytest.raises(ValueError, match="single input"):
        simulate_linear(control.append(discrete, discrete), [1.0])


def test_without_lag_and_modes_the_dynamics_pass_the_voltage_on_at_once():
    static = ElectricVibrationDynamics()
    assert static.is_static
    input_um = np.array([0.0, 3.0, -2.0])
    np.testing.assert_array_equal(simulate_linear(zoh(static.state_space(), 1e-3), input_um),
                                  input_um)
    np.testing.assert_array_equal(static.response([0.0, 1e3]), [1.0, 1.0])
    assert equilibrium_state(static.state_space(), 3.0).size == 0


def test_a_mode_needs_no_lag():
    dynamics = ElectricVibrationDynamics(0.0, (1000.0,), (0.1,))
    assert not dynamics.is_static
    system = dynamics.state_space()
    assert system.nstates == 2
    frequency_hz = np.array([1.0, 150.0, 400.0])
    s = 2j * np.pi * frequency_hz
    analytic = 1e6 / (s**2 + 200.0 * s + 1e6)
    np.testing.assert_allclose(dynamics.response(frequency_hz), analytic, rtol=1e-12)
    np.testing.assert_allclose(system(s), analytic, rtol=1e-12)


@pytest.mark.parametrize("samples", [FEWEST - 1, FEWEST, FEWEST + LENGTH - 1, 3 * FEWEST + 5])
def test_blocks_are_the_recursion_of_another_library_and_leave_its_state(
        samples, thesis_creep, antiresonant):
    generator = np.random.default_rng(samples)
    system = zoh(thesis_creep.state_space() * antiresonant.state_space(), PERIOD_S)
    state = generator.normal(size=system.nstates)
    driven = generator.normal(size=samples)
    output, after = continue_linear(system, driven, state)
    _, expected, states = scipy.signal.dlsim(
        (system.A, system.B, system.C, system.D, PERIOD_S), np.append(driven, 0.0), x0=state)
    np.testing.assert_allclose(output, expected[:-1, 0], atol=1e-12)
    np.testing.assert_allclose(after, states[-1], atol=1e-12)


def test_means_of_a_moving_input_are_answered_as_the_input_itself():
    """A mode behind a lag, in front of which every fourth value changes."""
    mode = ElectricVibrationDynamics(0.0, (20e3,), (0.02,)).state_space()
    lag = control.ss([[-2e4]], [[2e4]], [[1.0]], [[0.0]])
    held = np.repeat(np.random.default_rng(4).uniform(0.0, 1.0, 500), 4)
    wanted = simulate_linear(zoh(mode * lag, PERIOD_S / 4), held, np.zeros(3))
    # A lag changes by (held - mean) h / T within each part.
    ends = np.append(simulate_linear(zoh(lag, PERIOD_S / 4), held, np.zeros(1)), 0.0)
    means = (held - np.diff(ends) / (2e4 * PERIOD_S / 4))[:-1]
    plain, better = (simulate_linear(zoh(system, PERIOD_S / 4), means, np.zeros(2))
                     for system in (mode, answering_means(mode, PERIOD_S / 4)))
    plain_error, error = (np.std(found - wanted[:-1]) for found in (plain, better))
    assert error < 0.1 * plain_error


@pytest.mark.parametrize("rate_per_s", [1.0, 1e3, 1e6])
def test_the_answer_to_means_keeps_the_gain_at_rest_and_is_bounded(rate_per_s):
    lag = control.ss([[-rate_per_s]], [[rate_per_s]], [[1.0]], [[0.0]])
    corrected = answering_means(lag, 1e-3)
    assert corrected(0.0) == pytest.approx(1.0, abs=1e-12)
    assert np.abs(simulate_linear(zoh(corrected, 1e-3), np.ones(5), np.zeros(1))).max() < 1.2
