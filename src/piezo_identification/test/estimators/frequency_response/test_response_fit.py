# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import astuple

import numpy as np
import pytest

from piezo_identification.estimators.frequency_response.response_file import (
    FrequencyResponse,
    read_frequency_response,
)
from piezo_identification.estimators.frequency_response.response_fit import (
    ResponseModel,
    ResponseOrder,
    _ResponseFit,
    estimate_from_response,
)
from piezo_identification.estimators.frequency_response.response_standing import without_idle
from piezo_identification.estimators.frequency_response.vector_fitting import vector_fit
from piezo_identification.identification.linear_dynamics import LinearDynamics
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics

FREQUENCY_HZ = np.geomspace(1.0, 2000.0, 200)
TRUTH = ResponseModel(
    0.6, 3.6e-4, CreepDynamics((20.0,), (26.0,)),
    ElectricVibrationDynamics(
        3e-4, (2300.0, 4200.0, 6600.0), (0.02, 0.04, 0.012), (2400.0, 6300.0), (0.02, 0.015)),
)
ORDER = ResponseOrder(1, 3, 2)


def measured(seed, noise=0.002, model=TRUTH):
    rng = np.random.default_rng(seed)
    real, imaginary = noise * rng.normal(size=(2, FREQUENCY_HZ.size))
    return FrequencyResponse(
        "sweep", FREQUENCY_HZ, model.response(FREQUENCY_HZ) + real + 1j * imaginary)


def numbers(fields):
    """Every number of a model or of its standard deviations, by one order."""
    if isinstance(fields, dict):
        return np.concatenate([numbers(value) for value in fields.values()])
    return np.ravel(fields)


def parameters(model):
    return np.concatenate([
        [model.gain, model.delay_s], numbers(vars(model.creep)), numbers(vars(model.dynamics))])


@pytest.mark.kernels
def test_modes_antiresonances_creep_and_delay_are_found_with_their_number():
    estimate = estimate_from_response(measured(1))
    assert estimate.order == ORDER
    assert estimate.model.states == 8
    errors = parameters(estimate.model) - parameters(TRUTH)
    assert np.abs(errors / numbers(estimate.standard_deviations)).max() < 4.5
    assert estimate.model.delay_s == pytest.approx(3.6e-4, rel=0.01)
    assert estimate.model.dynamics.mode_frequencies_rad_per_s == pytest.approx(
        (2300.0, 4200.0, 6600.0), rel=1e-3)
    assert estimate.model.error(measured(2)) < 0.01
    chosen = next(line for line in estimate.order_table().splitlines() if "<-" in line)
    assert chosen.split()[0] == "1+3-2"


def test_standard_deviations_are_those_of_repeated_draws():
    fit = _ResponseFit(measured(0))
    start = fit.search(ORDER, 8)[ORDER].vector
    normalised = []
    for seed in range(30):
        fit.measured = measured(seed)
        drawn = fit.solve(ORDER, start)
        model = fit.model(drawn.vector, ORDER)
        if seed == 0:
            spread = numbers(estimate_from_response(fit.measured, ORDER).standard_deviations)
        normalised.append((np.sort(parameters(model)) - np.sort(parameters(TRUTH)))
                          / spread[np.argsort(parameters(TRUTH))])
    assert np.sqrt(np.mean(np.square(normalised), axis=0)) == pytest.approx(1.0, abs=0.5)


@pytest.mark.parametrize("order, further, parts", [
    (ResponseOrder(1, 1, 1), (), ()),
    (ResponseOrder(1, 1, 1, 2), (3300.0, 5000.0, 0.02, 0.04), (0.3, -0.2))])
def test_the_jacobian_is_that_of_the_response(order, further, parts):
    fit = _ResponseFit(measured(0))
    vector = np.concatenate([[0.5], np.log([
        0.6, 20.0, 26.0, 3e-4, 2300.0, 0.02, 2400.0, 0.03, *further]), parts])
    for column, step in zip(
        fit._jacobian(vector, order).T, 1e-6 * np.eye(vector.size), strict=True
    ):
        difference = fit._residual(vector + step, order) - fit._residual(vector - step, order)
        np.testing.assert_allclose(column, difference / 2e-6, atol=1e-6)


def test_a_given_order_is_kept_and_an_impossible_one_refused():
    estimate = estimate_from_response(measured(3), ResponseOrder(2, 3, 2))
    assert estimate.order_given
    assert len(estimate.model.creep.poles_rad_per_s) == 2
    with pytest.raises(ValueError, match="does not allow order 1[+]40-0"):
        estimate_from_response(measured(3), ResponseOrder(1, 40, 0))


@pytest.mark.parametrize("seed", [
    0, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(1, 20))])
def test_the_error_never_grows_with_the_order(seed):
    draw = np.random.default_rng(seed)
    frequencies = np.sort(draw.uniform(1000.0, 10000.0, 3))
    truth = ResponseModel(
        0.6, draw.uniform(0.0, 3e-4), CreepDynamics((20.0,), (26.0,)), ElectricVibrationDynamics(
            3e-4, frequencies, draw.uniform(0.005, 0.2, 3),
            np.sqrt(frequencies[1:] * frequencies[:-1])[:seed % 3],
            draw.uniform(0.01, 0.1, seed % 3)))
    trials = estimate_from_response(measured(seed, model=truth), most_states=8).trials
    assert len(trials) > 5
    for small in trials:
        for large in trials:
            if all(one <= other for one, other in zip(
                    astuple(small.order), astuple(large.order), strict=True)):
                assert large.residual_rms < (1.0 + 1e-3) * small.residual_rms, (
                    str(small.order), str(large.order))


def side_by_side(*modes, series=(4000.0,)):
    """Modes that add up, the last of them against the others: zeros in the right half plane."""
    return ResponseModel(
        0.25, 6e-5, CreepDynamics(),
        ElectricVibrationDynamics(1e-4, series, (0.012,) * len(series)),
        tuple(VibrationMode(*mode) for mode in modes))


def test_modes_that_add_up_are_found_where_zeros_lie_in_the_right_half_plane():
    truth = side_by_side((7400.0, 0.02, -0.6))
    assert truth.linear().zeros().real.max() > 0.0
    estimate = estimate_from_response(measured(4, model=truth), most_states=5)
    assert str(estimate.order) == "0+1-0+1"
    assert estimate.model.error(measured(4, 0.0, truth)) < 2e-3
    (mode,), (deviations,) = estimate.effects, estimate.effect_deviations
    assert abs(mode.participation + 0.6) < 4.0 * deviations["participation"]
    assert abs(mode.frequency_rad_per_s - 7400.0) < 4.0 * deviations["frequency_rad_per_s"]
    found = LinearDynamics().with_response(estimate)
    assert [effect.name for effect in found.all_effects] == ["vibration_mode", "delay"]
    assert [set(each) for each in found.effect_deviations] == [set(deviations), {"delay_s"}]


@pytest.mark.long
def test_an_amplifier_of_second_order_is_a_mode_that_only_lags():
    truth = ResponseModel(0.25, 0.0, CreepDynamics(), ElectricVibrationDynamics(
        3e-5, (4000.0, 7400.0, 9400.0), (0.012, 0.02, 0.8), (5700.0,), (0.02,)))
    estimate = estimate_from_response(measured(4, 3e-4, truth), most_states=8)
    assert str(estimate.order) == "0+3-1"
    assert estimate.model.error(measured(4, 0.0, truth)) < 2e-3


@pytest.mark.parametrize("vector, order, kept", [
    ([0.0, 1.0, 2.0, 8.0, 9.0, -3.0, -4.0, 8.5, 30.0, -3.0, -5.0], ResponseOrder(0, 2, 2),
     [0, 1, 2, 3, 4, 5, 6, 7, 9]),
    ([0.0, 1.0, 2.0, 8.0, -3.0, 8.5, 8.6, -3.0, -4.0, 0.3, 1e-4], ResponseOrder(0, 1, 0, 2),
     [0, 1, 2, 3, 4, 5, 7, 9]),
    ([0.0, 1.0, 2.0, 30.0, -3.0, 8.0, -4.0], ResponseOrder(0, 1, 1), range(7))])
def test_what_is_idle_is_left_out(vector, order, kept):
    """A zero above the band, a mode that moves nothing; not a mode whose zero would stay alone."""
    vector = np.array(vector)
    smaller, found = without_idle(vector, order, 1e-6 * np.eye(vector.size), np.exp(10.0))
    np.testing.assert_array_equal(smaller, vector[list(kept)])
    assert (found == order) == (smaller.size == vector.size)
    assert smaller.size == 3 + 2 * (found.modes + found.antiresonances) + 3 * found.beside


@pytest.mark.long
def test_eight_modes_of_a_mirror_are_found():
    frequencies = 2.0 * np.pi * np.array([150.0, 260, 390, 560, 760, 1000, 1300, 1650])
    mirror = ResponseModel(1.0, 1e-4, CreepDynamics(), ElectricVibrationDynamics(
        1e-4, frequencies, np.full(8, 0.01),
        np.sqrt(frequencies[1:] * frequencies[:-1]), np.full(7, 0.012)))
    estimate = estimate_from_response(measured(4, 1e-4, mirror))
    assert estimate.order.modes == 8
    assert estimate.model.error(measured(5, 1e-4, mirror)) < 1e-3


def test_vector_fitting_is_exact_for_a_rational_response():
    rational = ResponseModel(0.6, 0.0, TRUTH.creep, TRUTH.dynamics)
    rate = 2.0 * np.pi * FREQUENCY_HZ
    poles = vector_fit(rate, rational.response(FREQUENCY_HZ), 8)
    truth = np.concatenate([TRUTH.dynamics.state_space().poles(), [-20.0]])
    np.testing.assert_allclose(np.sort_complex(poles), np.sort_complex(truth), rtol=1e-5)


def test_a_csv_file_is_read(tmp_path):
    path = tmp_path / "response.csv"
    path.write_text("gain_im,frequency_hz,gain_re\n-0.1,1.0,0.7\n-0.2,2.5,0.6\n\n")
    response = read_frequency_response(path)
    np.testing.assert_array_equal(response.frequency_hz, [1.0, 2.5])
    np.testing.assert_array_equal(response.gain, [0.7 - 0.1j, 0.6 - 0.2j])
    assert response.between(2.0, 3.0).frequency_hz.size == 1
    with pytest.raises(ValueError, match="no frequency from 5 to 6 Hz: it covers 1 to 2.5 Hz"):
        response.between(5.0, 6.0)


@pytest.mark.parametrize(("text", "message"), [
    ("", "has no column frequency_hz"),
    ("frequency_hz,gain_re\n1,2\n", "has no column gain_im"),
    ("frequency_hz,gain_re,gain_im\n", "has no line of data"),
    ("frequency_hz,gain_re,gain_im\n1,2,3\n2,x,3\n", "line 3: a number is missing"),
    ("frequency_hz,gain_re,gain_im\n1,2\n", "line 2: a number is missing"),
    ("frequency_hz,gain_re,gain_im\n1,nan,3\n", "line 2: not a finite number"),
    ("frequency_hz,gain_re,gain_im\n2,1,1\n2,1,1\n", "line 3: frequency 2 Hz does not exceed"),
    ("frequency_hz,gain_re,gain_im\n0,1,1\n", "line 2: frequency 0 Hz does not exceed"),
])
def test_faulty_files_are_refused_with_line_and_cure(tmp_path, text, message):
    path = tmp_path / "response.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        read_frequency_response(path)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(ValueError, match="cannot be read"):
        read_frequency_response(tmp_path / "none.csv")


def test_too_few_frequencies_are_refused():
    few = FrequencyResponse("few", FREQUENCY_HZ[:6], np.ones(6, dtype=complex))
    with pytest.raises(ValueError, match="too few"):
        estimate_from_response(few)
