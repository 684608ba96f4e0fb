# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import replace
from itertools import count

import numpy as np
import pytest

from piezo_common.budget import Budget, spending
from piezo_identification.estimators.frequency_response.rational_form import (
    DELAY,
    LOSS,
    RationalForm,
)
from piezo_identification.estimators.frequency_response.response_file import (
    FrequencyResponse,
    read_frequency_response,
)
from piezo_identification.estimators.frequency_response.response_fit import (
    ANY_ORDER,
    STRONG_EVIDENCE,
    ResponseModel,
    ResponseOrder,
    _deviations,
    _model,
    estimate_from_response,
)
from piezo_identification.estimators.frequency_response.response_search import (
    ResponseSearch,
    weight_of_noise,
)
from piezo_identification.estimators.poles.vector_fitting import Lines, vector_fit
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
    errors = parameters(estimate.model) - parameters(TRUTH)
    assert np.abs(errors / numbers(estimate.standard_deviations)).max() < 4.5
    assert estimate.model.delay_s == pytest.approx(3.6e-4, rel=0.01)
    assert estimate.model.dynamics.mode_frequencies_rad_per_s == pytest.approx(
        (2300.0, 4200.0, 6600.0), rel=1e-3)
    assert estimate.model.error(measured(2)) < 0.01
    chosen = next(line for line in estimate.order_table().splitlines() if "<-" in line)
    assert chosen.split()[0] == "1+3-2"


@pytest.mark.parametrize("order", [ANY_ORDER, ResponseOrder(None, 2, None)])
def test_a_search_whose_time_is_over_takes_the_first_order_that_was_asked_for(order):
    budget = Budget(1.0, count().__next__)
    with spending(budget):
        estimate = estimate_from_response(measured(1), order)
    assert budget.not_tried == ["further orders of the response"]
    assert order.grants(estimate.order) and len(estimate.trials) == 1


@pytest.mark.long
def test_standard_deviations_are_those_of_repeated_draws():
    normalised = []
    for seed in range(30):
        estimate = estimate_from_response(measured(seed), ORDER)
        normalised.append((parameters(estimate.model) - parameters(TRUTH))
                          / numbers(estimate.standard_deviations))
    assert np.sqrt(np.mean(np.square(normalised), axis=0)) == pytest.approx(1.0, abs=0.5)


def test_a_lag_of_nearly_zero_has_a_standard_deviation():
    """A step towards smaller lags would leave what a model may have."""
    search, form = ResponseSearch(measured(1)), RationalForm(0, 1)
    vector = np.array([0.0, 1e-9, 0.0, 0.0, *np.log([2300.0, 0.02]), 0.6, 0.0])
    free = ~np.isin(np.arange(form.size), [DELAY, LOSS, *form.mode_places[3]])
    fit = search.fit((form, vector, free), steps=0)
    deviations, _ = _deviations(search, fit, _model(search, fit))
    assert 0.0 < deviations["dynamics"]["time_constant_s"] < np.inf


@pytest.mark.parametrize("form, vector", [
    (RationalForm(1, 1, 1, is_parallel=False), [
        0.5, 0.7, 0.05, *np.log([20.0, 26.0]), 0.6, *np.log([2300.0, 0.02, 2400.0, 0.03])]),
    (RationalForm(1, 2), [
        0.5, 0.7, 0.05, *np.log([20.0, 26.0]), 0.6, *np.log([2300.0, 5000.0, 0.02, 3.0]),
        0.3, -0.2, 0.1, 0.4])])
def test_the_derivatives_of_a_form_are_those_of_its_response(form, vector):
    vector, rate = np.array(vector), 2.0 * np.pi * FREQUENCY_HZ
    assert vector.size == form.size
    for column, step in zip(
        form.response(vector, rate)[1].T, 1e-6 * np.eye(vector.size), strict=True
    ):
        difference = form.response(vector + step, rate)[0] - form.response(vector - step, rate)[0]
        np.testing.assert_allclose(column, difference / 2e-6, atol=1e-6)


@pytest.mark.long
def test_a_given_order_is_kept_and_an_impossible_one_refused():
    estimate = estimate_from_response(measured(3), ResponseOrder(2, 3, 2))
    assert estimate.order_given
    assert len(estimate.model.creep.poles_rad_per_s) == 2
    with pytest.raises(ValueError, match="does not allow order 1[+]40-0"):
        estimate_from_response(measured(3), ResponseOrder(1, 40, 0))


@pytest.mark.parametrize("seed", [
    0, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(1, 20))])
def test_any_rational_response_is_left_at_its_noise_and_written_as_the_table_says(seed):
    """Modes of any residue, some close together, with a direct part, a lag, creep and a delay."""
    draw = np.random.default_rng(seed)
    count, s = draw.integers(2, 5), 2j * np.pi * FREQUENCY_HZ
    w = np.sort(draw.uniform(1500.0, 10000.0, count))
    w[1] = 1.03 * w[0] if seed % 3 == 0 else w[1]
    gain = np.full(s.shape, draw.choice([0.0, 0.3]), dtype=complex)
    for frequency, damping in zip(w, 10.0 ** draw.uniform(-2.0, -1.0, count), strict=True):
        ratio = s / frequency
        part = draw.choice([-1.0, 1.0]) * draw.uniform(0.3, 1.0)
        gain += (part + 0.3 * draw.normal() * ratio) / (ratio**2 + 2.0 * damping * ratio + 1.0)
    gain *= (s + 30.0) / (s + 22.0) / (1.0 + s * draw.uniform(0.0, 2e-4)) * np.exp(
        -s * draw.uniform(0.0, 5e-4))
    noise = draw.choice([0.005, 0.03]) * np.abs(gain)
    error = noise * (draw.normal(size=s.size) + 1j * draw.normal(size=s.size)) / np.sqrt(2.0)
    response = FrequencyResponse("drawn", FREQUENCY_HZ, gain + error)
    estimate = estimate_from_response(response)
    found = LinearDynamics().with_response(estimate)
    beside = [effect for effect in found.all_effects if effect.place == "modes"]
    written = (estimate.model.gain * np.exp(-s * found.delay_s)
               * found.creep.response(FREQUENCY_HZ)
               * found.dynamics.response(FREQUENCY_HZ, beside))
    np.testing.assert_allclose(written, estimate.model.response(FREQUENCY_HZ), rtol=1e-9)
    assert np.sqrt(np.mean(np.abs((written - gain) / noise) ** 2)) < 0.7
    chosen = next(trial for trial in estimate.trials if trial.order == estimate.order)
    least = min(trial.information for trial in estimate.trials)
    assert chosen.information <= least + STRONG_EVIDENCE
    assert not any(trial.refusal for trial in estimate.trials)


def test_a_mode_beside_a_small_lag_of_the_other_sign_is_found():
    s = 2j * np.pi * FREQUENCY_HZ
    gain = 0.25 / ((s / 7490.0) ** 2 + 0.04 * s / 7490.0 + 1.0) - 0.0125 / (1.0 + 8e-4 * s)
    draw = np.random.default_rng(1).normal(size=(2, s.size))
    response = FrequencyResponse("drawn", FREQUENCY_HZ, gain + 2e-4 * (draw[0] + 1j * draw[1]))
    model = estimate_from_response(response).model
    left = model.response(FREQUENCY_HZ) - gain
    assert np.linalg.norm(left) < 1e-3 * np.linalg.norm(gain)


def test_a_delay_without_evidence_is_left_out_and_the_rest_is_fitted_again():
    truth = replace(TRUTH, delay_s=0.0)
    estimate = estimate_from_response(measured(6, model=truth))
    assert estimate.model.delay_s == 0.0 and not estimate.order.has_delay
    assert estimate.model.error(measured(6, 0.0, truth)) < 0.01
    assert LinearDynamics().with_response(estimate).all_effects == ()


def test_frequencies_are_weighed_by_their_noise():
    draw = np.random.default_rng(3).normal(size=(2, 4000))
    gain = np.geomspace(1.0, 1e-3, 4000).astype(complex)
    noise = np.hypot(0.01 * np.abs(gain), 1e-3)
    weight = weight_of_noise(noise * (draw[0] + 1j * draw[1]), gain)
    np.testing.assert_allclose(weight * noise / np.mean(weight * noise), 1.0, atol=0.3)


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
    poles = vector_fit(Lines(rate, rational.response(FREQUENCY_HZ)), 8)
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


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(ValueError, match="cannot be read"):
        read_frequency_response(tmp_path / "none.csv")


def test_too_few_frequencies_are_refused():
    few = FrequencyResponse("few", FREQUENCY_HZ[:6], np.ones(6, dtype=complex))
    with pytest.raises(ValueError, match="too few"):
        estimate_from_response(few)
