# SPDX-License-Identifier: BSD-3-Clause
"""Stated deviations of effects beside a model with errors, against how far the effects are off."""

from dataclasses import replace

import numpy as np
import pytest
from made_by_scipy import behind_play, logged

from piezo_identification.diagnosis.evidence.effect_covariance import (
    noise_and_errors,
    with_model_errors,
)
from piezo_identification.fitting.dataset import simulate_recordings
from piezo_identification.fitting.effect_fit import fit_effects
from piezo_identification.fitting.regression import first_regression, reweighted
from piezo_models.cascade import StageModel
from piezo_models.effects.backlash import Backlash
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics

PERIOD_S, SAMPLES, NOISE_UM, WIDTH_UM = 1e-3, 3000, 2e-3, 0.3
CELLS, SPREAD = 48, 0.05


def stage(density_um_per_v2):
    return StageModel(
        PreisachModel(0.0, 100.0, density_um_per_v2, 0.0, np.full(CELLS, 0.05)), CreepDynamics(),
        ElectricVibrationDynamics(1e-3))


def density():
    """Return a density with a ridge near its diagonal, um/V^2."""
    middle = (np.arange(CELLS) + 0.5) * 100.0 / CELLS
    span, centre = np.subtract.outer(middle, middle), np.add.outer(middle, middle) / 2.0
    return np.tril(1e-3 * np.exp(-span / 6.0) + 1e-4 * (1.0 + 0.2 * np.sin(centre / 9.0)))


def with_errors(seed):
    """Return the density with another factor for each span."""
    factors = np.exp(SPREAD * np.random.default_rng([seed, 9]).normal(size=CELLS))
    return density() * sum(np.diag(np.full(CELLS - span, factors[span]), -span)
                           for span in range(CELLS))


def recording(stage, seed, width_um=WIDTH_UM):
    """Record tones with a play that is written as a loop, and noise."""
    generator = np.random.default_rng(seed)
    time_s = np.arange(SAMPLES) * PERIOD_S
    voltage_v = sum(
        size * np.sin(2.0 * np.pi * frequency_hz * time_s + generator.uniform(0.0, 6.0))
        for size, frequency_hz in zip(generator.uniform(4.0, 12.0, 4), (1.0, 2.3, 4.7, 9.1),
                                      strict=True)) + 50.0
    quiet = logged(voltage_v, np.zeros(SAMPLES), PERIOD_S, f"{seed}")
    drive_um = simulate_recordings(stage, [quiet], ()).simulated[0].simulate()
    trailing_um = drive_um[0] + behind_play(drive_um - drive_um[0], width_um)
    return replace(quiet, displacement_um=trailing_um + NOISE_UM * generator.normal(size=SAMPLES))


def errors_of_width(model, recorded):
    """Return the error of the width over its deviation, by the scatter and with the model's."""
    regression = first_regression(simulate_recordings(model, [recorded], ()))
    regression = reweighted(regression, fit_effects(regression, (Backlash(0.2),)).effects)
    fit = fit_effects(regression, (Backlash(0.2),))
    off = np.log(fit.effects[0].width_um / WIDTH_UM)
    return [off / np.sqrt(each.covariance[0, 0])
            for each in (fit, with_model_errors(regression, fit))]


def test_a_play_beside_a_model_with_errors_is_as_far_off_as_is_stated():
    model = stage(density())
    errors = [errors_of_width(model, recording(stage(with_errors(seed)), seed))
              for seed in range(8)]
    by_scatter, stated = np.sqrt(np.mean(np.square(errors), axis=0))
    assert by_scatter > 3.0
    assert 0.4 < stated < 1.7


def test_a_model_without_errors_widens_little():
    model = stage(density())
    by_scatter, stated = errors_of_width(model, recording(model, 1))
    assert abs(by_scatter) < 3.0
    assert abs(stated) == pytest.approx(abs(by_scatter), rel=0.8)


def waves(random, count):
    """Return slow signals of 2000 rows."""
    slow = np.cos(np.outer(np.arange(2000) / 2000, np.pi * np.arange(1, 30)))
    return slow @ random.normal(size=(29, count))


def test_white_noise_and_errors_that_neighbours_share_are_told_apart():
    random = np.random.default_rng(3)
    errors = waves(random, 200)
    told = [noise_and_errors(0.2 * waves(random, 1)[:, 0] + random.normal(size=2000), errors)
            for _ in range(60)]
    assert np.mean(told, axis=0) == pytest.approx((1.0, 0.04), rel=0.15)


def test_what_is_left_in_other_shapes_tells_nothing_of_the_errors():
    random = np.random.default_rng(5)
    errors, noise = waves(random, 200), random.normal(size=2000)
    other = np.cos(np.outer(np.arange(2000) / 2000, np.pi * np.arange(60, 90)))
    disturbance = 0.2 * other @ random.normal(size=30)
    _, alone = noise_and_errors(noise, errors)
    _, beside = noise_and_errors(noise + disturbance, errors)
    assert beside * np.mean(errors**2) < 0.1 * np.mean(disturbance**2)
    assert beside < 4.0 * alone


@pytest.mark.parametrize("errors", [np.ones((9, 4)), np.zeros((90, 4)), np.ones((90, 1))])
def test_few_rows_or_a_stage_without_hysteresis_tell_no_size(errors):
    assert noise_and_errors(np.ones(len(errors)), errors) == (1.0, 0.0)


def test_of_white_noise_alone_the_size_is_what_it_may_be():
    random = np.random.default_rng(4)
    errors = waves(random, 200)
    told = np.array([noise_and_errors(random.normal(size=2000), errors) for _ in range(40)])
    hidden = told[:, 1] * np.mean(errors**2)
    assert np.all(hidden > 0.0)
    assert np.mean(hidden) < 0.03
    assert np.mean(told[:, 0]) == pytest.approx(1.0, abs=0.03)
