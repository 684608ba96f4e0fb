# SPDX-License-Identifier: BSD-3-Clause
"""The last fit of all parameters of several axes to slow and fast recordings together."""

from dataclasses import replace

import numpy as np
import pytest

from piezo_common.budget import Budget, spending
from piezo_identification.axes.axes_errors import AxesErrors
from piezo_identification.axes.coupled_numbers import CoupledNumbers
from piezo_identification.axes.free_axes import FreeAxes
from piezo_identification.axes.modal_model import modal_model
from piezo_identification.axes.predict_axes import predict_several_axes
from piezo_identification.axes.whole_axes_fit import LAST_FIT, FittedStage, fit_to_all
from piezo_models.axes.actuator import Actuator
from piezo_models.effects.bouc_wen_hysteresis import BoucWenHysteresis
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics
from piezo_recorder.reading.axes import AxesRecording

PERIOD_S, NOISE_UM = 1e-4, 1e-3
NUMBERS = CoupledNumbers(
    np.exp(PERIOD_S * np.array([-40.0 + 1900.0j, -60.0 + 2800.0j, -4000.0])),
    np.array([[[1e-3, 2e-4], [-1e-4, 5e-4]], [[0.02, 1e-3], [2e-3, 5e-3]],
              [[5e-4, 1e-4], [2e-4, 1e-3]], [[4e-3, 1e-3], [-2e-3, 0.04]],
              [[0.02, 1e-3], [1e-3, 0.03]]]),
    np.array([[[1e-3, 1e-4], [1e-4, 2e-3]]]), np.zeros((0, 5, 2, 2)), np.zeros((0, 2, 2)), 5.0,
    np.ones(5))


def actuator(axis):
    density = np.tril(np.random.default_rng(axis).uniform(0.5, 1.5, (12, 12))) * 1e-5
    return Actuator(PreisachModel(0.0, 100.0, density, 0.0, np.full(12, 1e-3)),
                    CreepDynamics((2.0 + axis, 30.0), (2.03 + axis, 30.3)))


TRUE = replace(modal_model(NUMBERS, np.array([0, 2]), ("x", "y"), PERIOD_S),
               actuators=(replace(actuator(0), lag_s=1.5e-4), actuator(1)))


@pytest.fixture(scope="module")
def recordings():
    rng, samples = np.random.default_rng(4), 1500
    time_s = np.linspace(0.0, 1.0, samples)
    loops_v = 50.0 - (50.0 - 30.0 * time_s) * np.cos(8.0 * np.pi * time_s)
    fast_v = 50.0 + 10.0 * np.column_stack([np.sin(np.cumsum(rng.uniform(0.0, 1.5, samples)))
                                            for _ in range(2)])
    fast_v[:50] = fast_v[0]
    periodic_v = np.tile(fast_v[:1400] - fast_v[:1400].mean(axis=0) + 50.0, (2, 1))
    noise_um = NOISE_UM * rng.normal(size=periodic_v.shape)
    found = [AxesRecording("periodic", ("x", "y"), PERIOD_S, periodic_v,
                           TRUE.simulate(periodic_v, periodic=True) + noise_um, 2)]
    for name, voltage_v, period_s in (
            ("loops x", loops_v[:, None] * [1.0, 0.0], 4e-3),
            ("loops y", loops_v[:, None] * [0.0, 1.0], 4e-3), ("fast", fast_v, PERIOD_S)):
        goes_on = period_s != PERIOD_S
        model = TRUE.at_period(period_s, goes_on) if goes_on else TRUE
        noise_um = NOISE_UM * rng.normal(size=voltage_v.shape)
        found.append(AxesRecording(name, ("x", "y"), period_s, voltage_v,
                                   model.simulate(voltage_v, goes_on=goes_on) + noise_um))
    return found


def start(factor, true=TRUE):
    """Return the true stage with gains, poles, creep and hysteresis that are off."""
    free = FreeAxes(true, NUMBERS)
    changes = factor * np.random.default_rng(2).normal(size=free.low.size)
    changes[free.of_poles] /= 50.0
    numbers = free.numbers_at(changes)
    unknown = [np.eye(numbers.own().shape[1] + numbers.shared().size) for _ in range(2)]
    return FittedStage(numbers, free.model_at(changes), unknown)


@pytest.fixture(scope="module")
def fitted(recordings):
    return fit_to_all(start(0.1), recordings)


@pytest.mark.parametrize("bouc_wen", [
    pytest.param(None, marks=pytest.mark.long), BoucWenHysteresis(3.0, 15.0, unloading=0.7)])
def test_derivatives_are_those_of_the_function(recordings, bouc_wen):
    first, other = TRUE.actuators
    stage = start(0.05, replace(TRUE, actuators=(first, replace(other, bouc_wen=bouc_wen))))
    errors = AxesErrors(FreeAxes(stage.model, stage.numbers), recordings)
    at = 0.02 * np.random.default_rng(3).normal(size=errors.low.size)
    residual, jacobian = errors.linearised(at)
    along = np.random.default_rng(5).normal(size=at.size)
    step = 1e-4 * along
    slope = (errors.value(at + step) - errors.value(at - step)) / 2e-4
    assert residual @ jacobian @ along == pytest.approx(slope, rel=0.02)


def test_loops_after_which_the_stage_would_go_back_are_no_model(recordings):
    steep = replace(TRUE.actuators[1], bouc_wen=BoucWenHysteresis(6.0, 15.0, unloading=2.0))
    free = FreeAxes(replace(TRUE, actuators=(TRUE.actuators[0], steep)), NUMBERS)
    assert AxesErrors(free, recordings[:1]).value(np.zeros(free.low.size)) == np.inf


def test_slow_and_fast_recordings_are_explained_to_the_noise(recordings, fitted):
    for each in recordings:
        prediction = predict_several_axes(fitted.model, each)
        left_um = prediction.measured_um - prediction.simulated_um
        assert np.all(np.std(left_um, axis=0) < 1.3 * NOISE_UM), each.name


def test_deviations_of_the_poles_are_those_of_the_noise(fitted):
    m = NUMBERS.logarithms.size
    deviations = np.sqrt(np.diag(fitted.known[0]))[-m:]
    assert np.all(np.abs(fitted.numbers.logarithms - NUMBERS.logarithms) < 4.0 * deviations)
    assert np.all(deviations[:4] < 2e-3 * np.abs(NUMBERS.steps[0]))


def test_errors_are_never_larger_than_before_though_the_time_is_over(recordings):
    stage, budget = start(0.1), Budget(1e-9)
    with spending(budget):
        found = fit_to_all(stage, recordings)
    assert LAST_FIT in budget.not_tried
    np.testing.assert_array_equal(found.numbers.gains, stage.numbers.gains)
    assert found.known is stage.known


def test_an_axis_that_rests_without_noise_is_fitted_beside(recordings):
    resting = replace(recordings[1], displacement_um=recordings[1].displacement_um * [1.0, 0.0])
    stage = start(0.05)
    errors = AxesErrors(FreeAxes(stage.model, stage.numbers), [*recordings, resting])
    assert all(np.isfinite(each).all() for each in errors.linearised(np.zeros(errors.low.size)))
    assert np.isfinite(errors.value(np.zeros(errors.low.size)))


def test_an_axis_that_rests_elsewhere_does_not_shift_the_displacement(recordings):
    shifted = replace(recordings[2], displacement_um=recordings[2].displacement_um + [5.0, 0.0])
    stage = replace(start(0.0), model=TRUE)
    with spending(Budget(1e-9)):
        model = fit_to_all(stage, [*recordings, shifted]).model
    np.testing.assert_allclose(model.operating_displacement_um, TRUE.operating_displacement_um,
                               atol=NOISE_UM)
